"""A report in Markdown as one HTML file that holds its pictures, whose tables are sorted by a click on a heading."""

import base64
import html
import re
from collections.abc import Callable, Mapping
from importlib.resources import files

import markdown


def html_page(text: str, picture: Callable[[str], bytes]) -> str:
    """
    :param text: in Markdown; its first line is the title
    :param picture: gives the content of a PNG file that the text shows
    :return: the page, which needs no other file
    """
    folder = files("sb3_adaptive_q.experiments")
    title = text.partition("\n")[0].lstrip("# ")
    body = markdown.markdown(text, extensions=["tables", "toc"], extension_configs={"toc": {"toc_depth": "2-3"}})
    body = re.sub(r'src="([^"]+\.png)"', lambda match: f'src="{_data_address(picture(match[1]))}"', body)
    parts: Mapping[str, str] = {
        "TITLE": html.escape(title),
        "STYLE": (folder / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": (folder / "page.js").read_text(encoding="utf-8"),
        "BODY": body,
    }
    return re.sub("|".join(parts), lambda match: parts[match[0]], PAGE)


PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>TITLE</title>
<style>
STYLE</style>
</head>
<body>
<main>
BODY
</main>
<script>
SCRIPT</script>
</body>
</html>
"""


def _data_address(content: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(content).decode()}"
