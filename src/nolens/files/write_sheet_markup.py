"""A process sheet as HTML."""

from html import escape

from nolens.fabricate.sheet_parts import (
    Blank,
    Blanks,
    Block,
    Figure,
    Section,
    Sheet,
    Step,
    Steps,
    Table,
    Text,
)
from nolens.files.html_page import html_page
from nolens.files.write_sheet_svg import drawing_svg


def sheet_html(sheet: Sheet) -> str:
    """Write a sheet as an HTML document with everything in it.

    Boxes can be ticked and lines written on, on a screen as on paper; what is entered is kept
    by printing.
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
    return html_page(sheet.title, body, style="write_sheet.css", scheme="light dark")


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
            f"{drawing_svg(block.drawing, name)}\n"
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
    shares = "".join(f'<col style="width:{100 * share:g}%">' for share in table.shares)
    heads = "".join(f'<th scope="col">{escape(head)}</th>' for head in table.columns)
    rows = "\n".join(_row(row, table.columns) for row in table.rows)
    return (
        f"<table>\n<caption>{escape(table.caption)}</caption>\n<colgroup>{shares}</colgroup>\n"
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
