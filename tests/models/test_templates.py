"""What templates escape, and what they refuse."""

from pathlib import Path

import pytest
from jinja2 import UndefinedError

from taxel_models.templates import render


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_html_is_escaped(tmp_path: Path) -> None:
    assert (
        render(written(tmp_path, "a.html.j2", "<p>{{ x }}</p>\n"), x="<b> & c")
        == "<p>&lt;b&gt; &amp; c</p>\n"
    )


def test_markdown_is_escaped_where_it_is_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, "a.md.j2", "{{ x }} {{ x | md }}")
    assert render(path, x="|F| <b> < 1") == "|F| <b> < 1 \\|F\\| \\<b> < 1"


def test_latex_keeps_its_braces(tmp_path: Path) -> None:
    path = written(tmp_path, "a.tex.j2", r"\caption{{<< x | tex >>}}")
    assert render(path, x="5 % & a_b #1") == r"\caption{{5 \% \& a\_b \#1}}"


def test_a_name_that_is_not_given_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UndefinedError, match="'y' is undefined"):
        render(written(tmp_path, "a.md.j2", "{{ y }}"), x=1)
