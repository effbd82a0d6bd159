"""Structured text that runs: a tree of tree-sitter's grammar of IEC 61131-3, turned into Python.

Strict where a controller may be: Python raises on a division by zero, the root of a negative
number, an overflow, an index beyond an array's end, a name that was not declared. REAL is NumPy's
float32 with all floating-point errors raised. Names do not depend on case.
"""

import math
import operator
import re
from typing import Any

import numpy as np
import tree_sitter_iec61131_3_st
from tree_sitter import Language, Node, Parser

_PARSER = Parser(Language(tree_sitter_iec61131_3_st.language()))
_OPERATORS = {"=": "==", "<>": "!=", "AND": "and", "OR": "or", "NOT": "not "}
_LREAL = {
    "ABS": abs, "SQRT": math.sqrt, "SIN": math.sin, "COS": math.cos, "ASIN": math.asin,
    "ACOS": math.acos, "ATAN": math.atan, "EXP": math.exp, "LN": math.log, "EXPT": operator.pow,
}  # fmt: skip
_REAL = {
    "ABS": abs, "SQRT": np.sqrt, "SIN": np.sin, "COS": np.cos, "ASIN": np.arcsin,
    "ACOS": np.arccos, "ATAN": np.arctan, "EXP": np.exp, "LN": np.log, "EXPT": np.power,
}  # fmt: skip


class Program:
    """The units of one file.

    Attributes:
        root: the tree.
        sizes: of types of arrays.
        units: functions (inputs by name → result, outputs by name) and function blocks (classes).
    """

    def __init__(self, text: str) -> None:
        self.root = _PARSER.parse(text.encode()).root_node
        assert not self.root.has_error
        self.single = ": REAL" in text
        self._number = np.float32 if self.single else float
        self._scope: dict[str, Any] = {"number": self._number, "array": list, "copied": _copy}
        self._scope |= {name.lower(): f for name, f in (_REAL if self.single else _LREAL).items()}
        self.sizes: dict[str, int] = {}
        self.units: dict[str, Any] = {}
        for node in self.root.named_children:
            if node.type == "type_declaration":
                for definition in node.named_children:
                    array = definition.child_by_field_name("definition")
                    self.sizes[_text(definition, "name")] = _size(array)
            elif node.type in ("function_declaration", "function_block_declaration"):
                self._define(node)
            else:
                assert node.type == "comment", node.type

    def call(self, name: str, **inputs: Any) -> tuple[Any, dict[str, np.ndarray]]:
        """Call a function: its result and outputs."""
        given = {key: [self._number(x) for x in value] for key, value in inputs.items()}
        with np.errstate(all="raise", under="ignore"):
            result, outputs = self.units[name](**given)
        return result, {key: np.array(value, float) for key, value in outputs.items()}

    def _define(self, node: Node) -> None:
        name = _text(node, "name")
        sections = {child.type: self._declared(child) for child in node.named_children
                    if child.type.startswith("var_")}  # fmt: skip
        both = sections.get("var_input", []) + sections.get("var_in_out", [])
        inputs = [key for key, _ in both]
        outputs = [key for key, _ in sections.get("var_output", [])]
        own = sections.get("var_output", []) + sections.get("var_block", [])
        body = self._body(node.children_by_field_name("body"), 1)
        if node.type == "function_declaration":
            results = ", ".join(f"{key!r}: {key}" for key in outputs)
            done = f"return {name}_, {{{results}}}" if outputs else f"return {name}_"
            lines = [f"def {name}({', '.join(inputs)}):", f"    {name}_ = 0"]
            lines += [f"    {key} = {start}" for key, start in own]
            lines += [line.replace("RETURN", done) for line in body] + [f"    {done}"]
            lines = [lines[0], *(_own_name(line, name) for line in lines[1:])]
            exec("\n".join(lines), self._scope)
            self.units[name] = self._scope[name]
            return
        kept = {key: eval(start, self._scope) for key, start in own}
        state = ", ".join(f"{key!r}: {key}" for key in kept)
        lines = [f"def step({', '.join([*inputs, *kept])}):", *body, f"    return {{{state}}}"]
        exec("\n".join(lines), self._scope)
        step = self._scope.pop("step")

        def instance() -> Any:
            state = {key: _copy(value) for key, value in kept.items()}

            def cycle(**given: Any) -> tuple[None, dict[str, Any]]:
                with np.errstate(all="raise", under="ignore"):
                    state.update(step(**given, **state))
                return None, {key: _copy(state[key]) for key in outputs}

            return cycle

        self.units[name] = instance

    def _declared(self, section: Node) -> list[tuple[str, str]]:
        """Names of a section's variables and Python for what they start with."""
        found = []
        for declaration in section.named_children:
            if declaration.type != "variable_declaration":
                assert declaration.type in ("comment", "var_qualifier_list"), declaration.type
                continue
            kind = declaration.child_by_field_name("type")
            values = [
                self._value(child)
                for child in declaration.children_by_field_name("initial_value")
                if child.is_named and child.type != "comment"
            ]
            zero = "0" if b"INT" in kind.text else "False" if kind.text == b"BOOL" else "number(0)"
            start = values[0] if values else zero
            if kind.type in ("identifier", "array_type"):
                named = kind.type == "identifier"
                size = self.sizes[kind.text.decode().lower()] if named else _size(kind)
                assert (len(values) or size) == size
                start = f"[{', '.join(values)}]" if values else f"[{zero}] * {size}"
            names = [c for c in declaration.children_by_field_name("names") if c.is_named]
            found += [(name.text.decode().lower(), start) for name in names]
        return found

    def _body(self, nodes: list[Node], depth: int) -> list[str]:
        lines = [line for node in nodes if node.is_named for line in self._statement(node, depth)]
        return lines or [f"{'    ' * depth}pass"]

    def _statement(self, node: Node, depth: int) -> list[str]:
        pad, body = "    " * depth, node.children_by_field_name("body")
        if node.type in ("empty_statement", "comment"):
            return []
        if node.type == "assignment_statement":
            left, right = (node.child_by_field_name(side) for side in ("left", "right"))
            target = self._value(left)
            call = right.type == "call_expression" and _text(right, "function") in self.units
            outputs = [a for a in _arguments(right) if "=>" in a.text.decode()] if call else []
            if not outputs:
                return [f"{pad}{target} = {self._value(right)}"]
            lines = [f"{pad}{target}, given_ = {self._value(right)}"]
            for a in outputs:
                inner, outer = (part.strip().lower() for part in a.text.decode().split("=>"))
                lines.append(f"{pad}{outer} = given_[{inner!r}]")
            return lines
        if node.type == "if_statement":
            return self._branches(node, depth)
        if node.type == "for_statement":
            index, start, end = (self._part(node, key) for key in ("control", "start", "end"))
            return [f"{pad}for {index} in range({start}, {end} + 1):", *self._body(body, depth + 1)]
        return {"return_statement": [f"{pad}RETURN"], "exit_statement": [f"{pad}break"]}[node.type]

    def _branches(self, node: Node, depth: int) -> list[str]:
        pad = "    " * depth
        lines = [f"{pad}if {self._part(node, 'condition')}:"]
        lines += self._body(node.children_by_field_name("consequence"), depth + 1)
        for clause in node.named_children:
            if clause.type == "elsif_clause":
                lines.append(f"{pad}elif {self._part(clause, 'condition')}:")
            elif clause.type == "else_clause":
                lines.append(f"{pad}else:")
            else:
                continue
            lines += self._body(clause.children_by_field_name("body"), depth + 1)
        return lines

    def _part(self, node: Node, field: str) -> str:
        return self._value(node.child_by_field_name(field))

    def _value(self, node: Node) -> str:
        text = node.text.decode()
        if node.type == "identifier":
            return text.lower()
        if node.type == "integer_literal":
            return str(int(text))
        if node.type == "real_literal":
            return f"number({text})" if self.single else text
        if node.type == "boolean_literal":
            return text.capitalize()
        if node.type == "parenthesized_expression":
            return f"({self._value(node.named_children[0])})"
        if node.type == "index_expression":
            return f"{self._part(node, 'object')}[{self._part(node, 'index')}]"
        if node.type == "unary_expression":
            sign = node.child_by_field_name("operator").text.decode()
            return f"{_OPERATORS.get(sign, sign)}{self._part(node, 'operand')}"
        if node.type == "binary_expression":
            sign = node.child_by_field_name("operator").text.decode()
            sides = self._part(node, "left"), self._part(node, "right")
            return f"{sides[0]} {_OPERATORS.get(sign, sign)} {sides[1]}"
        assert node.type == "call_expression", node.type
        given = []
        for a in _arguments(node):
            if a.type != "named_argument":
                given.append(self._value(a))
            elif ":=" in a.text.decode():
                given.append(f"{_text(a, 'name')}=copied({self._part(a, 'value')})")
        return f"{_text(node, 'function')}({', '.join(given)})"


def _copy(value: Any) -> Any:
    return list(value) if isinstance(value, list) else value


def _arguments(node: Node) -> list[Node]:
    return node.child_by_field_name("arguments").named_children


def _text(node: Node, field: str) -> str:
    return node.child_by_field_name(field).text.decode().lower()


def _find(node: Node, kind: str) -> Node:
    return next(child for child in node.named_children if child.type == kind)


def _size(array: Node) -> int:
    """How many entries a type of arrays has, which count from 0."""
    low, high = (int(c.text) for c in _find(array, "subrange").named_children)
    assert low == 0
    return high + 1


def _own_name(line: str, name: str) -> str:
    """What a function returns is a variable of its own name."""
    return re.sub(rf"^( *){name} = ", rf"\1{name}_ = ", line)
