"""Where the project lives is one variable, DELTAID_PROJECT_URL; this writes it into a package.

Without it a package names no address, and README keeps the links that it has in the repository.
"""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

VARIABLE = "DELTAID_PROJECT_URL"
_PICTURE = re.compile(r'(!\[[^\]]*\]\(|<img src="|srcset=")(?!https?://|#)')
_LINK = re.compile(r"(?<!!)(\[[^\]\n]*\]\()(?!https?://|#)")


class ProjectUrl(MetadataHookInterface):
    """Adds README and the addresses of the project to a package's metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in what pyproject.toml calls dynamic."""
        url = os.environ.get(VARIABLE, "").rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": readme(text, url)}
        metadata["urls"] = addresses(url)


def addresses(url: str) -> dict[str, str]:
    """The addresses that an index shows, of a repository's address; none without one."""
    if not url:
        return {}
    pages = {"Source": "", "Documentation": "/tree/main/docs", "Issues": "/issues"}
    pages["Changelog"] = "/blob/main/CHANGELOG.md"
    return {name: url + page for name, page in pages.items()}


def readme(text: str, url: str) -> str:
    """README as an index can show it: links and pictures lead to the repository."""
    if not url:
        return text
    text = _PICTURE.sub(rf"\1{url}/raw/main/", text)
    return _LINK.sub(rf"\1{url}/blob/main/", text)
