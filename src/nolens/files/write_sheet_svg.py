"""Drawings to scale as SVG."""

from html import escape

from nolens.fabricate.drawing import INK, TONES, Drawing, Line, Shape, Word

FONTS = "'DejaVu Sans', Verdana, sans-serif"


def drawing_svg(drawing: Drawing, name: str) -> str:
    """Write a drawing as an SVG element whose unit is the millimetre on paper.

    Parameters
    ----------
    drawing
        The drawing.
    name
        Begins the identifiers of its title and description; unlike those of other drawings.
    """
    size = f"{_number(drawing.width_mm)}mm", f"{_number(drawing.height_mm)}mm"
    box = f"0 0 {_number(drawing.width_mm)} {_number(drawing.height_mm)}"
    lines = [
        f'<svg width="{size[0]}" height="{size[1]}" '
        f'viewBox="{box}" role="img" aria-labelledby="{name}-title {name}-text" '
        f'data-scale="{_number(drawing.scale)}" font-family="{FONTS}">',
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
