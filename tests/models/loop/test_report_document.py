"""A document as Markdown and as HTML."""

import re
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from taxel_models.loop.report.document import Document, Heading, Paragraph, Picture, Table
from taxel_models.loop.report.rendering import html, markdown

CELLS = st.text(st.characters(codec="ascii", categories=("L", "N", "P", "S", "Zs")), max_size=12)


@given(st.lists(st.tuples(CELLS, CELLS), min_size=1, max_size=4))
def test_markdown_tables_keep_their_columns(rows: list[tuple[str, str]]) -> None:
    lines = markdown(Document("t", (Table(("a", "b"), tuple(rows)),))).splitlines()[2:]
    assert len(lines) == len(rows) + 2
    for line in lines:
        assert len(re.findall(r"(?<!\\)(?:\\\\)*\|", line)) == 3


def test_markdown_leaves_plain_figures_readable() -> None:
    text = markdown(Document("t", (Paragraph("play[0.2N].force, p < 0.001, w_c |F|, <b>"),)))
    assert text == "# t\n\nplay[0.2N].force, p < 0.001, w_c \\|F\\|, \\<b>\n"


def test_html_escapes_names_and_embeds_pictures(tmp_path: Path) -> None:
    (tmp_path / "one.png").write_bytes(b"picture")
    blocks = (
        Heading("<script>alert(1)</script>"),
        Paragraph('a < b & "c"'),
        Picture("one.png", 'title "quoted"', "caption"),
        Table(("<i>",), (("</td>",),)),
    )
    page = html(Document("<t>", blocks), tmp_path)
    assert "<script" not in page
    assert "a &lt; b &amp; &#34;c&#34;" in page
    assert 'alt="title &#34;quoted&#34;" src="data:image/png;base64,cGljdHVyZQ=="' in page
    assert "<th>&lt;i&gt;</th>" in page
    assert "<td>&lt;/td&gt;</td>" in page
