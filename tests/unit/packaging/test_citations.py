"""Citations point to documents that are in the repository, or that are published."""

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

from docs.site_pages import PAGES

ROOT = Path(__file__).resolve().parents[3]
SUFFIXES = (".py", ".md", ".yaml", ".toml", ".c", ".h", ".service", "Makefile")
DOCUMENT = re.compile(r"(?<![\w/*{<$%:@.-])((?:\.\./)*(?:[\w-]+/)*[\w-]+\.md)\b(?!\")")
SECTION = re.compile(r"\.md,? sections? \d")  # no document of ours has numbered sections
PRIVATE = re.compile(
    r"\b(?:design|reference|engine|lab|review|unit's) notes?\b|\bnotes, section\b"
    r"|\bsurvey, (?:section )?\d|\(reference: (?!command|Reference|Motion)"
    r"|\bcontract, \"|\bresults? contract\b"
    r"|\bprivate communication\b|\bunpublished\b",
    re.IGNORECASE,
)
ISSUE = re.compile(r"(?<!/)\bissue #?\d+")
PUBLISHED = re.compile(r"\b[\w-]+/[\w-]+[,)]? issue|github\.com")


def cited_places() -> Iterator[tuple[str, str]]:
    """Yield each text file with its text, without this one."""
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for path in listed.stdout.splitlines():
        if path.endswith(SUFFIXES) and path != Path(__file__).relative_to(ROOT).as_posix():
            yield path, (ROOT / path).read_text(encoding="utf-8", errors="replace")


def exists(citing: str, cited: str) -> bool:
    """Return whether a document is in the repository, or on the site that it makes."""
    places = (ROOT, ROOT / "docs", (ROOT / citing).parent)
    name = cited.replace("../", "")
    return any((p / cited).is_file() or (p / name).is_file() for p in places) or name in PAGES


def unknown_citations() -> Iterator[str]:
    for path, text in cited_places():
        for number, line in enumerate(text.splitlines(), 1):
            words = [match[0] for match in (SECTION.search(line), PRIVATE.search(line)) if match]
            if ISSUE.search(line) and not PUBLISHED.search(line):
                words.append(line.strip())
            if not path.startswith("tests/") or "/test_" not in path:  # tests make documents
                words += [cited for cited in DOCUMENT.findall(line) if not exists(path, cited)]
            yield from (f"{path}:{number} {word}" for word in words)


def test_every_cited_document_is_in_the_repository_or_published() -> None:
    assert list(unknown_citations()) == []
