"""Pages from templates: one environment, every text escaped; pictures inside the page."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from cassini_bayes.report.plots import encode

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def rendered(template: str, **values: object) -> str:
    """A template of ``report/templates`` as text; a name it lacks is an error, not a gap.

    What goes into a page is escaped, what goes into a file of code is not.
    """
    environment = Environment(
        loader=PackageLoader("cassini_bayes", "report/templates"),
        autoescape=select_autoescape(("html.jinja",), ("py.jinja", "toml.jinja"), default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(values)


def address_of(content: bytes, media: str) -> str:
    """A picture as an address that holds it."""
    return f"data:{media};base64,{base64.b64encode(content).decode('ascii')}"


def svg_address(figure: Figure) -> str:
    """A figure, drawn as SVG, as an address that holds it."""
    return address_of(encode(figure, "svg"), "image/svg+xml")
