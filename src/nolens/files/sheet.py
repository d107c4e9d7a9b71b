"""A process sheet as HTML, for the screen and for the wall above the bench, drawings as SVG."""

from html import escape
from pathlib import Path

from nolens.fabricate.sheet_parts import (
    INK,
    TONES,
    Blank,
    Blanks,
    Block,
    Drawing,
    Figure,
    Line,
    Section,
    Shape,
    Sheet,
    Step,
    Steps,
    Table,
    Text,
    Word,
)
from nolens.files.atomic import atomic_write
from nolens.files.reports import html_page

_FONTS = "'DejaVu Sans', Verdana, sans-serif"


def write_sheet_html(path: str | Path, sheet: Sheet) -> None:
    """Write a sheet as one HTML file that needs no other; it prints on A4, drawings to scale.

    Boxes can be ticked and lines written on, on a screen as on paper; what is entered is kept by
    printing. The same sheet gives the same bytes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    sections = "\n".join(
        _section(section, number) for number, section in enumerate(sheet.sections, 1)
    )
    body = f"""<header>
<h1>{escape(sheet.title)}</h1>
<p class="subtitle">{escape(sheet.subtitle)}</p>
</header>
{sections}
"""
    page = html_page(sheet.title, body, style="sheet.css", scheme="light dark")
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _section(section: Section, number: int) -> str:
    blocks = "\n".join(
        _block(block, f"drawing-{number}-{place}") for place, block in enumerate(section.blocks)
    )
    return f"<section>\n<h2>{escape(section.title)}</h2>\n{blocks}\n</section>"


def _block(block: Block, name: str) -> str:
    if isinstance(block, Text):
        return f'<p class="{block.kind}">{escape(block.text)}</p>'
    if isinstance(block, Blanks):
        return f'<div class="blanks">{"".join(map(_blank, block.blanks))}</div>'
    if isinstance(block, Figure):
        return (
            f'<figure>\n<p class="head">{escape(block.drawing.title)}</p>\n'
            f"{_svg(block.drawing, name)}\n"
            f"<figcaption>{escape(block.caption)}</figcaption>\n</figure>"
        )
    if isinstance(block, Steps):
        steps = enumerate(block.steps, block.first)
        items = "\n".join(_step(number, step) for number, step in steps)
        return f'<ol class="steps" start="{block.first}">\n{items}\n</ol>'
    return _table(block)


def _step(number: int, step: Step) -> str:
    amount = f'<strong class="amount">{escape(step.amount)}</strong>' if step.amount else ""
    return (
        f'<li><input type="checkbox" aria-label="step {number} done">'
        f'<span class="number">{number}</span>'
        f"<div><p>{escape(step.text)}</p>{amount}</div>"
        f"<div>{''.join(map(_blank, step.blanks))}</div>"
        f'<span class="origin">{escape(step.origin)}</span></li>'
    )


def _table(table: Table) -> str:
    widths = "".join(f'<col style="width:{100 * part:g}%">' for part in table.fractions)
    heads = "".join(f'<th scope="col">{escape(head)}</th>' for head in table.columns)
    rows = "\n".join(_row(row, table.columns) for row in table.rows)
    return (
        f"<table>\n<caption>{escape(table.caption)}</caption>\n<colgroup>{widths}</colgroup>\n"
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>"
    )


def _row(row: tuple[str | Blank, ...], columns: tuple[str, ...]) -> str:
    name = row[0] if isinstance(row[0], str) else row[0].label
    cells = [f'<th scope="row">{escape(name)}</th>']
    for cell, column in zip(row[1:], columns[1:], strict=True):
        content = escape(cell) if isinstance(cell, str) else _blank(cell, f"{name}, {column}")
        cells.append(f"<td>{content}</td>")
    return f"<tr>{''.join(cells)}</tr>"


def _blank(blank: Blank, name: str = "") -> str:
    label = f"{escape(blank.label)}: " if blank.label else ""
    unit = f" {escape(blank.unit)}" if blank.unit else ""
    spoken = escape(", ".join(filter(None, (name or blank.label, blank.unit))))
    return (
        f'<label class="blank">{label}<input type="text" aria-label="{spoken}" '
        f'autocomplete="off">{unit}</label>'
    )


def _svg(drawing: Drawing, name: str) -> str:
    """A drawing as an SVG element whose unit is the millimetre on paper.

    `name` begins the identifiers of its title and description, unlike those of other drawings.
    """
    size = f"{_number(drawing.width_mm)}mm", f"{_number(drawing.height_mm)}mm"
    box = f"0 0 {_number(drawing.width_mm)} {_number(drawing.height_mm)}"
    lines = [
        f'<svg width="{size[0]}" height="{size[1]}" '
        f'viewBox="{box}" role="img" aria-labelledby="{name}-title {name}-text" '
        f'data-scale="{_number(drawing.scale)}" font-family="{_FONTS}">',
        f'<title id="{name}-title">{escape(drawing.title)}</title>',
        f'<desc id="{name}-text">{escape(drawing.description)}</desc>',
        *map(_shape, drawing.shapes),
        "</svg>",
    ]
    return "\n".join(lines)


def _shape(shape: Shape) -> str:
    if isinstance(shape, Word):
        weight = ' font-weight="bold"' if shape.bold else ""
        return (
            f'<text x="{_number(shape.at[0])}" y="{_number(shape.at[1])}" '
            f'font-size="{_number(shape.size_mm)}" text-anchor="{shape.anchor}"{weight} '
            f'fill="{INK}">{escape(shape.text)}</text>'
        )
    part = f' data-part="{escape(shape.part)}"' if shape.part else ""
    stroke = f'stroke="{INK}" stroke-width="{_number(shape.weight_mm)}"'
    if isinstance(shape, Line):
        ends = zip(("x1", "y1", "x2", "y2"), (*shape.start, *shape.end), strict=True)
        places = " ".join(f'{key}="{_number(value)}"' for key, value in ends)
        return f"<line {places} {stroke}{part}/>"
    points = " ".join(f"{_number(x)},{_number(y)}" for x, y in shape.points)
    fill = TONES[shape.tone]
    return f'<polygon points="{points}" fill="{fill}" {stroke} stroke-linejoin="round"{part}/>'


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")
