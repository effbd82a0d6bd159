"""The notebook of the documentation: executed, compared with what it stores, and made a page.

    python tests/notebook_page.py [--renew]

says whether docs/notebook.ipynb stores what its cells give today and docs/notebook.md shows just
that; with --renew it writes both, and pictures of the figures, which needs Chromium. Figures are
stored as pictures for pages that run no script, with what they show as words in the metadata of
their output.
"""

import base64
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = ROOT / "docs" / "notebook.ipynb"
PAGE = NOTEBOOK.with_suffix(".md")
PICTURES = ROOT / "docs" / "images" / "notebook"
_FIGURE = "application/vnd.plotly.v1+json"
_NUMBER = re.compile(r"[-−]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")
# The search of a motion ends elsewhere on other processors, and there other limits are full. Spaces
# depend on the digits of numbers beside them.
_LIMIT, _SPACE = re.compile(r"(?<=100 % )\([^)]*\)"), re.compile(r"\s+(?=[],])|(?<=\[)\s+")
_MARKUP = re.compile(r"<style>.*?</style>|<[^>]+>", re.DOTALL)
# Numbers may differ by this share of themselves, since machines round otherwise and searches end
# elsewhere; and so many of a cell's numbers by more.
_CLOSE, _MOSTLY = 0.2, 0.4
_WIDTH = 860


def stored() -> Any:
    """The notebook as it is."""
    return nbformat.read(NOTEBOOK, as_version=4)


def executed() -> Any:
    """The same with the outputs of today, run in an empty folder."""
    notebook = stored()
    with tempfile.TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        client = NotebookClient(notebook, timeout=120, kernel_name="python3", resources=where)
        client.execute(env=os.environ | {"PYTHONPATH": str(ROOT / "src")})
    for cell in code(notebook):
        cell["outputs"] = [
            output for output in map(_as_stored, cell["outputs"]) if output is not None
        ]
        cell["metadata"].pop("execution", None)
    return notebook


def code(notebook: Any) -> list[Any]:
    """Cells that are run."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def differences(old: Any, new: Any) -> Iterator[str]:
    """What cells store and no longer give."""
    for pair in zip(code(old), code(new), strict=True):
        first = pair[0]["source"].splitlines()[0]
        before, after = (list(map(_words, cell["outputs"])) for cell in pair)
        if list(map(_masked, before)) != list(map(_masked, after)):
            yield f"{first}: stores {before}, gives {after}"
            continue
        pairs = list(zip(_numbers(before), _numbers(after), strict=True))
        far = sum(abs(a - b) > _CLOSE * max(abs(a), abs(b)) for a, b in pairs)
        if far > _MOSTLY * len(pairs):
            yield f"{first}: {far} of {len(pairs)} numbers are others"


def page(notebook: Any) -> str:
    """The notebook as Markdown: code as blocks, cards as HTML, figures as pictures."""
    parts = list[str]()
    for k, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "markdown":
            parts.append(cell["source"])
            continue
        parts.append(f"```py\n{cell['source']}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f"![{cell['metadata']['alt']}](images/notebook/{k + 1}.png)")
            elif "text/html" in data:
                scrolls = '<div style="overflow-x:auto;margin:1em 0">'
                parts.append(f"{scrolls}{_one_line(data['text/html'])}</div>")
            else:
                text = output.get("text") or data["text/plain"]
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def shown(figure: dict[str, Any]) -> str:
    """What a figure shows: its curves, by kind and name."""
    curves = (f"{trace['type']} {trace.get('name', '')}".strip() for trace in figure["data"])
    return "; ".join(curves)


def _as_stored(output: Any) -> Any | None:
    """An output as it is stored; None of a bar that has gone."""
    output.pop("execution_count", None)
    data = output.get("data", {})
    if _FIGURE in data:
        figure = data.pop(_FIGURE)
        output["metadata"] = {"figure": shown(figure)}
        output["_figure"] = figure
    elif output["output_type"] == "stream":
        return output if output["name"] == "stdout" else None
    elif not data.get("text/plain"):
        return None
    if output["output_type"] == "execute_result":
        output["execution_count"] = None
    return output


def _masked(text: str) -> str:
    """Words without what differs from machine to machine."""
    return _NUMBER.sub("#", _SPACE.sub("", _LIMIT.sub("", text)))


def _words(output: Any) -> str:
    """Text; a table's from its HTML, as plain text folds it by the digits of its numbers."""
    text = output.get("text") or output["metadata"].get("figure") or output["data"]["text/plain"]
    html = output.get("data", {}).get("text/html", "")
    if ".dataframe" in html:
        text = _MARKUP.sub(" ", html)
    return " ".join(text.split())


def _numbers(texts: list[str]) -> list[float]:
    return [float(number.replace("−", "-")) for text in texts for number in _NUMBER.findall(text)]


def _one_line(html: str) -> str:
    """HTML as Markdown leaves it alone: no empty lines, no indents; tables as the site has them."""
    text = "".join(line.strip() for line in html.splitlines())
    return re.sub(r"<(table|tr|th|td)\b[^>]*>", r"<\1>", text)


def _pictures(notebook: Any) -> None:
    """Figures as pictures, in the notebook and beside the page."""
    import plotly
    from playwright.sync_api import sync_playwright

    PICTURES.mkdir(exist_ok=True)
    script = "f => Plotly.newPlot(d, f.data, f.layout).then(() => Plotly.toImage(d, f.size))"
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=flags)
        tab = browser.new_page()
        tab.set_content("<div id=d></div>")
        tab.add_script_tag(content=plotly.offline.get_plotlyjs())
        for k, cell in enumerate(notebook["cells"]):
            for output in cell.get("outputs", ()):
                if (figure := output.pop("_figure", None)) is None:
                    continue
                height = figure["layout"].get("height", 450)
                size = {"format": "png", "width": _WIDTH, "height": height}
                url = tab.evaluate(script, {**figure, "size": size})
                picture = url.partition(",")[2]
                output["data"]["image/png"] = picture
                (PICTURES / f"{k + 1}.png").write_bytes(base64.b64decode(picture))
        browser.close()


def _formatted(notebook: Any) -> None:
    """What stands in cells goes through the formatter like all code."""
    for cell in code(notebook):
        command = [sys.executable, "-m", "ruff", "format", "-q", "--line-length", "92", "-"]
        found = subprocess.run(command, input=cell["source"], capture_output=True, text=True)
        cell["source"] = found.stdout.rstrip() if found.returncode == 0 else cell["source"]


def main() -> None:
    """Compare, or renew."""
    old = stored()
    new = executed()
    if "--renew" in sys.argv:
        _formatted(new)
        _pictures(new)
        nbformat.write(new, NOTEBOOK)
        PAGE.write_text(page(new), encoding="utf-8")
        return
    found = list(differences(old, new))
    if PAGE.read_text(encoding="utf-8") != page(old):
        found.append("the page does not show what the notebook stores")
    print(*found, sep="\n")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
