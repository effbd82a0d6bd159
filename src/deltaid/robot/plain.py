"""YAML nodes as plain values: no tags, no objects, no endless references."""

from datetime import date
from typing import Any

from ruamel.yaml.comments import CommentedMap, CommentedSeq, TaggedScalar

from deltaid.errors import DescriptionError

# A model file has some 700 nodes. Aliases may refer to aliases, so a short text can have billions.
_MOST_NODES, _DEEPEST = 20_000, 30


def plain(tree: CommentedMap, where: str) -> dict[str, Any]:
    """The mapping of a YAML file with strings, numbers, truth values, lists and mappings only.

    Raises:
        DescriptionError: something else is in it, or far too much.
    """
    return _Walk(where).value(tree, 0, 0)


class _Walk:
    def __init__(self, where: str) -> None:
        self._where = where
        self._nodes = 0

    def value(self, node: Any, line: int, depth: int) -> Any:
        self._nodes += 1
        if self._nodes > _MOST_NODES or depth > _DEEPEST:
            raise DescriptionError("has too many entries or levels", where=self._where)
        if type(node) is CommentedMap:
            self._refuse_tag(node, line)
            lines = {key: _line(node.lc.key, key, line) for key in node}
            return {str(k): self.value(v, lines[k], depth + 1) for k, v in node.items()}
        if type(node) is CommentedSeq:
            self._refuse_tag(node, line)
            return [
                self.value(v, _line(node.lc.item, i, line), depth + 1) for i, v in enumerate(node)
            ]
        if isinstance(node, TaggedScalar):
            self._refuse_tag(node, line)
        for kind in (bool, int, float, str):
            if isinstance(node, kind):
                return kind(node)
        if node is None or isinstance(node, date):
            return None if node is None else str(node)
        raise self._unusable(f"holds a {type(node).__name__}", line)

    def _refuse_tag(self, node: Any, line: int) -> None:
        tag = getattr(node.tag, "value", None) or getattr(node.tag, "suffix", None)
        if tag:
            raise self._unusable(f"has the tag {str(tag)[:60]}", line)

    def _unusable(self, what: str, line: int) -> DescriptionError:
        return DescriptionError(
            f"{what}, which means nothing here",
            where=f"{self._where}, line {line + 1}",
            cure="write plain numbers, text, lists and keys with values",
        )


def _line(position: Any, key: Any, default: int) -> int:
    """The line of a key or item; merged keys (<<) have none of their own."""
    try:
        return position(key)[0]
    except (KeyError, TypeError):
        return default
