"""Hooks of mkdocs: add the pages that the code generates, and replace links that leave docs/.

mkdocs loads this module by its path (mkdocs.yml, `hooks`). The hook makes the pages in memory for
each build, so they are never out of date.
"""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from docs import site_pages  # noqa: E402 - first add the checkout to the path

LINK = re.compile(r"\[([^\]]+)\]\((?!https?://|#)([^)\s#]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that the code generates."""
    for name, page in site_pages.PAGES.items():
        files.append(File.generated(config, name, content=page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: MkDocsConfig, files: Files) -> str:
    """Replace links to files of the checkout that are not pages by their names.

    A link to a missing file stays, so that the strict build rejects it.
    """
    folder = (Path(config.docs_dir) / page.file.src_uri).parent

    def replace_link(match: re.Match[str]) -> str:
        text, target = match[1], match[2]
        path = (folder / target).resolve()
        docs = Path(config.docs_dir).resolve()
        if not path.exists():
            return match[0]
        if path.is_relative_to(docs):
            name = path.relative_to(docs).as_posix()
            if files.get_file_from_path(name) is not None:
                return match[0]
            if path.is_dir() and (path / "index.md").is_file():
                return f"[{text}]({target.rstrip('/')}/index.md{match[3] or ''})"
        return text if text.startswith("`") or path.suffix == ".md" else f"{text} (`{path.name}`)"

    return LINK.sub(replace_link, markdown)
