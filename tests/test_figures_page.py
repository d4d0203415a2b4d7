"""The page: everything inside, nothing from outside, nothing taken for markup."""

from html.parser import HTMLParser

import pytest
from needleforce.plots.errors import ChartError, WriteError

from needleforce.plots import Attachment, Page, PageFigure, PageTable, Section, write_page

DOT = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><circle r="4"/></svg>'


class Elements(HTMLParser):
    """Start tags with their attributes, and the tags left open."""

    VOID = ("meta", "link", "img", "br")

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def of(self, tag):
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "dot.svg"
    path.write_bytes(DOT)
    figure = PageFigure(path=path, alt='a "dot"', caption="From `a`\nand b")
    table = PageTable(
        caption="Numbers <1>",
        head=("what", "N"),
        rows=(("a & b", "1.0"), ("`c`", "2.0")),
        numeric=frozenset({1}),
        note="A note.",
    )
    sections = tuple(
        Section(
            heading=f"Part {k}",
            anchor=f"part-{k}",
            paragraphs=("Text.",),
            notices=("Beware.",),
            figures=(figure, figure),
            tables=(table,),
            command="python -m a > b",
            attachments=(Attachment(name="a.json", media_type="application/json", content=b"{}"),),
        )
        for k in range(3)
    )
    return Page(title="A & B", lead=("Lead.",), sections=sections)


def test_every_element_is_closed_and_everything_is_there(page):
    elements = Elements(page.html())
    assert elements.open == []
    assert len(elements.of("section")) == 3
    assert len(elements.of("figure")) == len(elements.of("img")) == 6
    assert len(elements.of("table")) == 3
    assert elements.of("html") == [{"lang": "en"}]
    assert any(item.get("name") == "viewport" for item in elements.of("meta"))


def test_nothing_comes_from_outside(page):
    elements = Elements(page.html())
    places = [
        value
        for _, found in elements.found
        for name, value in found.items()
        if name in ("src", "href")
    ]
    assert len(places) == 6 + 3 + 3 + 1
    assert all(place.startswith(("data:", "#")) for place in places)
    assert "url(" not in page.html()
    assert "@import" not in page.html()
    assert elements.of("script") == []
    policy = next(item["content"] for item in elements.of("meta") if "http-equiv" in item)
    assert policy.startswith("default-src 'none'")


def test_links_within_the_page_lead_somewhere(page):
    elements = Elements(page.html())
    anchors = {item["id"] for item in elements.of("section")}
    links = [item["href"][1:] for item in elements.of("a") if item["href"].startswith("#")]
    assert set(links) == anchors


def test_a_short_page_needs_no_contents(page):
    short = Page(title="a", sections=page.sections[:2])
    assert Elements(short.html()).of("nav") == []


def test_text_is_never_taken_for_markup(page):
    html = page.html()
    assert "<title>A &amp; B</title>" in html
    assert "Numbers &lt;1&gt;" in html
    assert "a &amp; b" in html
    assert "python -m a &gt; b" in html
    assert 'alt="a &quot;dot&quot;"' in html
    assert "<code>c</code>" in html
    assert "From <code>a</code><br>and b" in html


def test_every_image_says_what_it_shows(page):
    assert all(image["alt"] for image in Elements(page.html()).of("img"))


def test_wide_tables_scroll_in_a_box_that_keys_can_reach(page):
    boxes = [item for item in Elements(page.html()).of("div") if item.get("class") == "scroll"]
    assert len(boxes) == 3
    assert all(box["tabindex"] == "0" and box["aria-label"] for box in boxes)


def test_a_page_is_written(page, tmp_path):
    path = write_page(tmp_path / "index.html", page)
    assert path.read_text(encoding="utf-8") == page.html()


def test_what_cannot_be_written_or_read_is_said(page, tmp_path):
    with pytest.raises(WriteError, match="cannot write"):
        write_page(tmp_path / "none" / "index.html", page)
    lost = PageFigure(path=tmp_path / "lost.svg", alt="a", caption="b")
    with pytest.raises(WriteError, match="cannot read"):
        lost.html()


def test_a_ragged_table_is_refused():
    with pytest.raises(ChartError, match="a row of 1 cells under 2 heads"):
        PageTable(caption="a", head=("b", "c"), rows=(("d",),))
