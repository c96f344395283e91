"""What the site's builder asks of us: pages made of the code, links that leave docs/.

mkdocs loads this by its path (mkdocs.yml, `hooks`). The pages are never written to disk, so
they cannot be out of date.
"""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from docs import site_pages  # noqa: E402 - the checkout is not on the path before

LINK = re.compile(r"\[([^\]]+)\]\((?!https?://|#)([^)\s#]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made of the code."""
    for name, page in site_pages.PAGES.items():
        files.append(File.generated(config, name, content=page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files of the checkout that are no pages into their names.

    A link to what does not exist at all stays, for the strict build to refuse.
    """
    here = (Path(config.docs_dir) / page.file.src_uri).parent

    def plain(match: re.Match[str]) -> str:
        text, target = match[1], match[2]
        place = (here / target).resolve()
        docs = Path(config.docs_dir).resolve()
        if not place.exists():
            return match[0]
        if place.is_relative_to(docs):
            name = place.relative_to(docs).as_posix()
            if files.get_file_from_path(name) is not None:
                return match[0]
            if place.is_dir() and (place / "index.md").is_file():
                return f"[{text}]({target.rstrip('/')}/index.md{match[3] or ''})"
        return text if text.startswith("`") or place.suffix == ".md" else f"{text} (`{place.name}`)"

    return LINK.sub(plain, markdown)
