"""The page: everything inside, nothing from outside, nothing taken for markup."""

import re

import pytest

from needleforce.plots import (
    Page,
    PageFigure,
    PageTable,
    Section,
    WriteError,
    write_page,
)

pytest.importorskip("matplotlib")


@pytest.fixture
def page(dot):
    figure = PageFigure(path=dot, alt='a "dot"', caption="From `a`\nand b", wide=dot)
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
    }
    sections = [
        Section(heading=f"Part {k}", anchor=f"part-{k}", **parts) for k in range(3)
    ]
    return Page(title="A & B", lead=("Lead.",), sections=tuple(sections))


def test_page_is_complete_and_needs_nothing_outside(page):
    html = page.html()
    counts = {
        "section": 3,
        "table": 3,
        "figure": 6,
        "picture": 6,
        "nav": 1,
        "script": 0,
    }
    for tag, count in counts.items():
        assert len(re.findall(rf"<{tag}\b", html)) == html.count(f"</{tag}>") == count

    assert html.count("<img ") == 6
    assert '<html lang="en">' in html
    assert '<meta name="viewport"' in html
    assert "content=\"default-src 'none';" in html

    addresses = re.findall(r' (?:src|srcset|href)="([^"]*)"', html)

    assert (
        len(addresses)
        == len(re.findall(r"(?:src|srcset|href)=", html))
        == 6 + 6 + 3 + 1
    )
    assert all(place.startswith(("data:", "#")) for place in addresses)
    assert not re.search(r"url\(|@import", html)

    boxes = re.findall(
        r'<div class=scroll role=region tabindex=0 aria-label="[^"]+">', html
    )

    assert len(boxes) == 3, "keys reach them"

    links = {place[1:] for place in addresses if place.startswith("#")}

    assert links == set(re.findall(r'<section id="(.*?)">', html))
    assert "<nav" not in Page(title="a", sections=page.sections[:2]).html()


def test_odd_text_is_never_taken_for_markup(page, tmp_path):
    path = write_page(tmp_path / "index.html", Page(title="Forces from a\udcff.csv"))

    assert r"<h1>Forces from a\udcff.csv</h1>" in path.read_text(encoding="utf-8")

    html = page.html()

    assert html == write_page(path, page).read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in html
    assert "Numbers &lt;1&gt;" in html
    assert "a &amp; b" in html
    assert re.findall(r'<img .* alt="(.*)">', html) == ["a &#34;dot&#34;"] * 6
    assert "<code>c</code>" in html
    assert "From <code>a</code><br>and b" in html


def test_unwritable_and_unreadable_are_refused(page, tmp_path):
    with pytest.raises(WriteError, match="cannot write"):
        write_page(tmp_path / "none" / "index.html", page)

    lost = PageFigure(path=tmp_path / "lost.svg", alt="a", caption="b")

    with pytest.raises(WriteError, match="cannot read"):
        Page(
            title="a", sections=(Section(heading="a", anchor="a", figures=(lost,)),)
        ).html()
