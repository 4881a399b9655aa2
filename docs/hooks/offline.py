"""Search without a web server and without the web: the script that the plugin `offline` wants to load is ours."""

import re
from typing import Any

from mkdocs.utils import get_relative_url

SCRIPT = "javascripts/worker.js"
_FROM_THE_WEB = re.compile(r'<script src="https://unpkg\.com/iframe-worker/shim"></script>')


def on_post_page(output: str, *, page: Any, **_: Any) -> str:
    """What mkdocs calls for every page when it is whole."""
    return _FROM_THE_WEB.sub(f'<script src="{get_relative_url(SCRIPT, page.url)}"></script>', output)


def on_post_template(output: str, *, template_name: str, **_: Any) -> str:
    """What mkdocs calls for pages that are no documents, such as 404.html."""
    return _FROM_THE_WEB.sub("", output)
