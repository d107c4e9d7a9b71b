"""A page of HTML with everything in it."""

from html import escape
from importlib.resources import files


def html_page(
    title: str, body: str, *, style: str, scheme: str, head: str = "", end: str = ""
) -> str:
    """Put a document together.

    Parameters
    ----------
    title
        As plain text.
    body
        Markup of what it shows.
    style
        File of its style, beside this one.
    scheme
        Colour schemes that the style knows: light, dark or both.
    head
        More markup of the head.
    end
        Markup after what it shows.
    """
    css = (files("nolens.files") / style).read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en-GB">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="{scheme}">
{head}<title>{escape(title)}</title>
<style>
{css}</style>
</head>
<body>
<main>
{body}</main>
{end}</body>
</html>
"""
