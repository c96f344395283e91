"""Confusion matrix as SVG: the name that each cause was given at 2x and 3x.

What to use when: `confusion_picture` for the page of scores.
"""

from collections import Counter
from collections.abc import Sequence
from html import escape

from tests.hidden.scoring.figures import count_confusions
from tests.hidden.scoring.outcome import AMONG, MISSED, REST, Outcome

CELL, LEFT, TOP = 18, 190, 170
STYLE = (
    ".paper{fill:#fbfaf7}.ink{fill:#1f2328;font-size:11px}.soft{fill:#5c6470;font-size:11px}"
    ".line{stroke:#c9ccd1;stroke-width:.5}.right{fill:#0f766e}.wrong{fill:#c2410c}"
    "@media (prefers-color-scheme:dark){.paper{fill:#14161a}.ink{fill:#e7e9ec}"
    ".soft{fill:#a0a7b2}.line{stroke:#4a505a}}"
)


def confusion_picture(outcomes: Sequence[Outcome]) -> str:
    """Return the SVG: one row per hidden cause, one column per stated name."""
    counts: dict[str, Counter[str]] = {}
    for times in (2.0, 3.0):
        for cause, counter in count_confusions(outcomes, times).items():
            counts.setdefault(cause, Counter()).update(counter)
    rows = sorted(counts)
    others = sorted({name for counter in counts.values() for name in counter} - {*rows})
    last = [name for name in (AMONG, REST, MISSED) if name in others]
    columns = [*rows, *(name for name in others if name not in last), *last]
    width, height = LEFT + CELL * len(columns) + 20, TOP + CELL * len(rows) + 40
    body = [*_draw_names(rows, columns), *_draw_cells(counts, rows, columns)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        'aria-labelledby="title" font-family="system-ui, sans-serif">\n'
        '<title id="title">Confusion matrix: the name given to each hidden cause, at two and '
        f"three times its detectable size.</title>\n<style>{STYLE}</style>\n"
        f'<rect class="paper" width="{width}" height="{height}" rx="10"/>\n'
        + "\n".join(body)
        + f'\n<text class="soft" x="{LEFT}" y="{height - 14}">row: hidden cause; column: stated '
        "name; darker cells are more frequent</text>\n</svg>\n"
    )


def _draw_names(rows: Sequence[str], columns: Sequence[str]) -> list[str]:
    out = []
    for k, name in enumerate(rows):
        y = TOP + CELL * k + 13
        out.append(
            f'<text class="ink" x="{LEFT - 8}" y="{y}" text-anchor="end">{escape(name)}</text>'
        )
    for k, name in enumerate(columns):
        x = LEFT + CELL * k + 13
        at = f'x="{x}" y="{TOP - 8}" transform="rotate(-60 {x} {TOP - 8})"'
        out.append(f'<text class="ink" {at}>{escape(name)}</text>')
    return out


def _draw_cells(
    counts: dict[str, Counter[str]], rows: Sequence[str], columns: Sequence[str]
) -> list[str]:
    out = []
    for i, hidden in enumerate(rows):
        y = TOP + CELL * i
        end = LEFT + CELL * len(columns)
        out.append(f'<line class="line" x1="{LEFT}" y1="{y}" x2="{end}" y2="{y}"/>')
        total = sum(counts[hidden].values())
        for j, column in enumerate(columns):
            count = counts[hidden][column]
            if count:
                kind = "right" if column in (hidden, AMONG) else "wrong"
                share = count / total
                out.append(
                    f'<rect class="{kind}" x="{LEFT + CELL * j + 1}" y="{y + 1}" '
                    f'width="{CELL - 2}" height="{CELL - 2}" rx="2" '
                    f'opacity="{0.25 + 0.75 * share:.2f}"><title>{escape(hidden)}: {count} of '
                    f"{total} called {escape(column)}</title></rect>"
                )
    return out
