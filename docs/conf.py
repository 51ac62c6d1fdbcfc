"""Sphinx settings: MyST pages, the API from docstrings, no network while building."""

import re
from importlib.metadata import version as installed_version

project = "cassini_bayes"
author = "the cassini_bayes maintainers"
project_copyright = "2026, the cassini_bayes maintainers"
release = version = installed_version("cassini-bayes")

extensions = [
    "myst_parser",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",  # the browser typesets the formulas; without a network they read as TeX
    "sphinx.ext.napoleon",
]
exclude_patterns = ["_build", "_api/modules.rst"]
suppress_warnings = ["ref.python"]  # fields of several classes share short names such as "event"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# One page per module, made from the files there are.
apidoc_modules = [
    {
        "path": "../cassini_bayes",
        "destination": "_api",
        "separate_modules": True,
        "module_first": True,
        "max_depth": 1,
        "automodule_options": {"members"},
    }
]
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"cassini_bayes {release}"
html_show_sourcelink = False


def _bars_are_magnitudes(app, what, name, obj, options, lines):
    """In a docstring |x| is a magnitude, never a substitution; ``literal`` text is left alone."""
    for number, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[number] = "".join(parts)


def _documented_elsewhere(app, what, name, obj, skip, options):
    """Leave out what a module only shows: names of its own package's face and of libraries."""
    home = getattr(obj, "__module__", None)
    here = app.env.current_document.docname.removeprefix("_api/")
    return True if home is not None and what == "module" and home != here else None


def _wide_parts_take_focus(app, page, template, context, doctree):
    """Code and tables that are wider than a phone are scrolled by keyboard, too."""
    body = context.get("body", "").replace("<pre", '<pre tabindex="0"')
    context["body"] = body.replace('<div class="table-w', '<div tabindex="0" class="table-w')


def _modules_are_listed_beside_modules(app, page, template, context, doctree):
    """Beside a page of a module its own branch, beside others two levels: no list of modules.

    Hundreds of names beside every page hide the few that are looked for, and took half of a build.
    """
    of_all = context.get("toctree")
    if of_all is not None:
        is_module = page.startswith(("_api/", "reference/modules"))
        depth = {"collapse": True} if is_module else {"maxdepth": 2}
        context["toctree"] = lambda **options: of_all(**options | depth)


def setup(app):
    """Hook the docstrings after napoleon has read them, and pages before they are written."""
    app.connect("html-page-context", _wide_parts_take_focus)
    app.connect("html-page-context", _modules_are_listed_beside_modules, priority=400)
    app.connect("autodoc-skip-member", _documented_elsewhere)
    app.connect("autodoc-process-docstring", _bars_are_magnitudes, priority=900)
