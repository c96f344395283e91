"""Draw the layers of the three packages from their imports: `python -m docs.layers`.

The rows are the layers of the import contracts in pyproject.toml. The arrows are the imports in
the code. A test compares docs/img/layers.svg with the drawing of this module.
"""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import grimp

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "img" / "layers.svg"
PACKAGES = ("gyrorig_daemon", "gyrorig_solver", "gyrorig_protocol")
BOX_WIDTH, BOX_HEIGHT, GAP_X, GAP_Y, MARGIN = 108, 26, 14, 30, 16
COLOURS = {
    "gyrorig_daemon": "#dbe9f6",
    "gyrorig_solver": "#e3f1dc",
    "gyrorig_protocol": "#f7e8cf",
}


@dataclass(frozen=True, slots=True)
class Box:
    """One subpackage in the drawing."""

    name: str  # dotted, for example gyrorig_solver.discover
    x: float
    y: float

    @property
    def top(self) -> tuple[float, float]:
        """Middle of the upper edge."""
        return self.x + BOX_WIDTH / 2, self.y

    @property
    def bottom(self) -> tuple[float, float]:
        """Middle of the lower edge."""
        return self.x + BOX_WIDTH / 2, self.y + BOX_HEIGHT


def read_layer_rows(package: str) -> list[list[str]]:
    """Return the layers of a package from its contract, the highest first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    for contract in contracts["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers" and contract.get("containers") == [package]:
            return [
                [f"{package}.{name.strip()}" for name in row.split("|")]
                for row in contract["layers"]
            ]
    raise KeyError(f"pyproject.toml has no layers contract for {package}")


def place_boxes() -> tuple[list[Box], float, float]:
    """Return the boxes, the width and the height: daemon next to solver, protocol below both."""
    boxes: list[Box] = []
    left, deepest = float(MARGIN), 0.0
    width: float
    for package in ("gyrorig_daemon", "gyrorig_solver"):
        rows = read_layer_rows(package)
        width = float(max(len(row) for row in rows) * (BOX_WIDTH + GAP_X) - GAP_X)
        for depth, row in enumerate(rows):
            y = MARGIN + 24 + depth * (BOX_HEIGHT + GAP_Y)
            start = left + (width - (len(row) * (BOX_WIDTH + GAP_X) - GAP_X)) / 2
            for column, name in enumerate(row):
                x = start + column * (BOX_WIDTH + GAP_X)
                boxes.append(Box(name, x, y))
            deepest = max(deepest, y)
        left += width + 3 * GAP_X
    width = left - 3 * GAP_X + MARGIN
    first_row = deepest + BOX_HEIGHT + 2 * GAP_Y
    rows = read_layer_rows("gyrorig_protocol")
    for depth, row in enumerate(rows):
        start = (width - (len(row) * (BOX_WIDTH + GAP_X) - GAP_X)) / 2
        for column, name in enumerate(row):
            x = start + column * (BOX_WIDTH + GAP_X)
            boxes.append(Box(name, x, first_row + depth * (BOX_HEIGHT + GAP_Y)))
    height = max(box.y for box in boxes) + BOX_HEIGHT + MARGIN
    return boxes, width, height


def find_imports(boxes: list[Box]) -> Iterator[tuple[Box, Box]]:
    """Yield importer and imported box of each import inside a package."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    for importer in boxes:
        package = importer.name.split(".")[0]
        for imported in boxes:
            if importer is imported or not imported.name.startswith(package + "."):
                continue
            if graph.direct_import_exists(
                importer=importer.name, imported=imported.name, as_packages=True
            ):
                yield importer, imported


def draw_layers() -> str:
    """Return the drawing as SVG text."""
    boxes, width, height = place_boxes()
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        'font-family="system-ui, sans-serif" font-size="11">',
        "<title>Layers of the three packages and the imports between them</title>",
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    for importer, imported in find_imports(boxes):
        (x1, y1), (x2, y2) = importer.bottom, imported.top
        out.append(
            f'<path d="M{x1:g} {y1:g} C{x1:g} {y1 + 18:g} {x2:g} {y2 - 18:g} {x2:g} {y2:g}" '
            'fill="none" stroke="#8a94a0" stroke-width="0.8" opacity="0.6"/>'
        )
    for box in boxes:
        package, name = box.name.split(".", 1)
        out.append(
            f'<rect x="{box.x:g}" y="{box.y:g}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="4" '
            f'fill="{COLOURS[package]}" stroke="#5b6670"/>'
            f'<text x="{box.top[0]:g}" y="{box.y + 17:g}" text-anchor="middle" '
            f'font-weight="600">{escape(name)}</text>'
        )
    for package in PACKAGES:
        first = min((b for b in boxes if b.name.startswith(package + ".")), key=lambda b: b.y)
        x = min(b.x for b in boxes if b.name.startswith(package + "."))
        out.append(
            f'<text x="{x:g}" y="{first.y - 8:g}" font-weight="700" font-size="13">{package}</text>'
        )
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    PICTURE.write_text(draw_layers(), encoding="utf-8")
    print(PICTURE.relative_to(ROOT))
