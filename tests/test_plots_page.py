"""The page: everything inside, nothing from outside, nothing taken for markup; in a browser."""

from dataclasses import make_dataclass
from html.parser import HTMLParser

import numpy as np
import pytest
from chromium import DESK, PHONE, logged, measured, needs_chromium, printed

from needleforce.plots import (
    Attachment,
    Chart,
    Curve,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    palette,
    save_figure,
    save_page_figure,
    settings_table,
    write_page,
)
from needleforce.plots.chart import ChartError, WriteError

pytest.importorskip("matplotlib")
DOT = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><circle r="4"/></svg>'


class Elements(HTMLParser):
    """Start tags with their attributes, and the tags left open."""

    VOID = ("meta", "link", "img", "br", "source")

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
    figure = PageFigure(path=path, alt='a "dot"', caption="From `a`\nand b", wide=path)
    table = PageTable(
        caption="Numbers <1>",
        head=("what", "N"),
        rows=(("a & b", "1.0"), ("`c`", "2.0")),
        numeric=frozenset({1}),
        note="A note.",
    )
    parts = {
        "paragraphs": ("Text.",),
        "notices": ("Beware.",),
        "figures": (figure, figure),
        "tables": (table,),
        "command": "python -m a > b",
        "attachments": (Attachment("a.json", "application/json", b"{}"),),
    }
    sections = [Section(heading=f"Part {k}", anchor=f"part-{k}", **parts) for k in range(3)]
    return Page(title="A & B", lead=("Lead.",), sections=tuple(sections))


def test_everything_is_there_and_nothing_comes_from_outside(page):
    elements = Elements(page.html())
    assert elements.open == [], "every element is closed"
    assert len(elements.of("section")) == len(elements.of("table")) == 3
    assert len(elements.of("figure")) == len(elements.of("img")) == 6
    assert elements.of("html") == [{"lang": "en"}]
    assert any(item.get("name") == "viewport" for item in elements.of("meta"))
    names = ("src", "srcset", "href")
    found = [item for _, items in elements.found for item in items.items() if item[0] in names]
    assert len(found) == 6 + 6 + 3 + 3 + 1
    assert all(place.startswith(("data:", "#")) for _, place in found)
    assert "url(" not in page.html()
    assert "@import" not in page.html()
    assert elements.of("script") == []
    policy = next(item["content"] for item in elements.of("meta") if "http-equiv" in item)
    assert policy.startswith("default-src 'none'")
    boxes = [item for item in elements.of("div") if item.get("class") == "scroll"]
    assert len(boxes) == 3
    assert all(box["tabindex"] == "0" and box["aria-label"] for box in boxes), "keys reach them"
    links = [item["href"][1:] for item in elements.of("a") if item["href"].startswith("#")]
    assert set(links) == {item["id"] for item in elements.of("section")}
    assert Elements(Page(title="a", sections=page.sections[:2]).html()).of("nav") == []


def test_text_and_names_that_are_not_utf_8_are_never_taken_for_markup(page, tmp_path):
    path = write_page(tmp_path / "index.html", Page(title="Forces from a\udcff.csv"))
    assert r"<h1>Forces from a\udcff.csv</h1>" in path.read_text(encoding="utf-8")
    html = page.html()
    assert html == write_page(path, page).read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in html
    assert "Numbers &lt;1&gt;" in html
    assert "a &amp; b" in html
    assert "python -m a &gt; b" in html
    assert all(image["alt"] == 'a "dot"' for image in Elements(html).of("img"))
    assert "<code>c</code>" in html
    assert "From <code>a</code><br>and b" in html


def test_what_cannot_be_written_or_read_or_is_ragged_is_refused(page, tmp_path):
    with pytest.raises(WriteError, match="cannot write"):
        write_page(tmp_path / "none" / "index.html", page)
    with pytest.raises(ChartError, match="a row of 1 cells under 2 heads"):
        PageTable(caption="a", head=("b", "c"), rows=(("d",),))
    lost = PageFigure(path=tmp_path / "lost.svg", alt="a", caption="b")
    with pytest.raises(WriteError, match="cannot read"):
        Page(title="a", sections=(Section(heading="a", anchor="a", figures=(lost,)),)).html()


def test_settings_are_listed_with_those_within():
    inner = make_dataclass("Inner", ["gain", "names"])(1234567.0, ("a", 2.5))
    outer = make_dataclass("Outer", ["inner", "friction", "empty"])(inner, None, ())
    inside = {"`inner.gain`": "1.23457e+06", "`inner.names`": "a, 2.5"}
    table = settings_table(outer, "Sensor")
    assert dict(table.rows) == inside | {"`friction`": "none", "`empty`": "none"}


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """A page with all that may be too wide for a screen."""
    folder = tmp_path_factory.mktemp("page")
    x = np.linspace(0.0, 10.0, 3000)
    curve = Curve(style=palette.OURS, x=x, y=np.sin(x), label="a force")
    panel = Panel(y_label=palette.FORCE, curves=(curve,))
    chart = Chart(title="a chart", x_label=palette.TIME, panels=(panel,))
    figures = (
        save_page_figure(chart, folder / "a.svg", alt="a", caption="A pair.", is_alone=False),
        PageFigure(path=save_figure(chart, folder / "b.png"), alt="b", caption="A pair."),
        save_page_figure(chart, folder / "c.svg", alt="c", caption="Alone.", is_alone=True),
    )
    head = tuple(f"a column called {k}" for k in range(30))
    parts = {
        "paragraphs": ("`averylongwordwithoutaplacetobreak`" * 4,),
        "figures": figures,
        "tables": (PageTable(caption="Wide", head=head, rows=(("0.123456789",) * 30,) * 40),),
        "command": "python -m benchmarks run " + "one-scenario-after-the-other " * 20,
    }
    sections = [Section(heading=f"Part {k}", anchor=f"part-{k}", **parts) for k in range(3)]
    return write_page(folder / "index.html", Page(title="A page", sections=tuple(sections)))


@needs_chromium
def test_it_prints_logs_nothing_and_a_resource_from_outside_would_be_logged(opened, tmp_path):
    assert printed(opened, tmp_path / "a.pdf") >= 2
    assert logged(opened) == []
    broken = opened.with_name("broken.html")
    text = opened.read_text(encoding="utf-8")
    broken.write_text(text.replace("</main>", '<img src="lost.png"></main>'), encoding="utf-8")
    assert logged(broken)


@needs_chromium
def test_every_figure_is_seen_and_nothing_sticks_out(opened):
    shape = {}
    for size in (PHONE, DESK):
        found = measured(opened, size)
        assert found["window"] == size[0]
        assert found["content"] <= size[0]
        assert found["wide"] == []
        assert len(found["images"]) == 9
        assert all(image["natural"] > 0 and image["height"] > 100 for image in found["images"])
        assert found["letters"] >= 14.0
        # A table that goes on to the side says so on a phone.
        assert found["hints"] == (3 if size == PHONE else 0)
        least = {PHONE: 0.85, DESK: 0.4}[size] * size[0]
        assert all(image["width"] > least for image in found["images"])
        alone = [image for image in found["images"] if image["alt"] == "c"]
        assert all(image["width"] > 0.85 * size[0] for image in alone), "it takes the whole width"
        shape[size] = alone[0]["width"] / alone[0]["height"]
    assert shape[DESK] > 1.5 * shape[PHONE], "it is drawn for the screen it is on"
