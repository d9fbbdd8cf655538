"""Renders Jinja2 templates, such as those of reports."""

import re
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_MARKDOWN_SPECIAL: Final = re.compile(r"([\\`*|]|<(?=[A-Za-z/!?]))")
"""What Markdown, or a table's row, would take for its own."""

_LATEX_SPECIAL: Final = re.compile(r"([%_&#])")


def render(template: Path, **values: Any) -> str:
    """The text of a template.

    HTML (`.html.j2`) is escaped by itself. Markdown has the filter `md`; LaTeX (`.tex.j2`) has the
    filter `tex`, and its delimiters are `<<`, `>>`, `<%` and `%>`, since braces are its own.

    Args:
        template: the file; others that it includes lie beside it.
        values: by the names that the template uses.

    Raises:
        jinja2.UndefinedError: the template uses a name that was not given.
    """
    of_latex = template.name.endswith(".tex.j2")
    delimiters = _LATEX_DELIMITERS if of_latex else {}
    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=template.name.endswith(".html.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **delimiters,
    )
    environment.filters["md"] = lambda text: _MARKDOWN_SPECIAL.sub(r"\\\1", str(text))
    environment.filters["tex"] = lambda text: _LATEX_SPECIAL.sub(r"\\\1", text)
    return environment.get_template(template.name).render(**values)


_LATEX_DELIMITERS: Final[dict[str, Any]] = {
    "block_start_string": "<%",
    "block_end_string": "%>",
    "variable_start_string": "<<",
    "variable_end_string": ">>",
    "comment_start_string": "<#",
    "comment_end_string": "#>",
}
