"""The page in a browser: at a desk, on a phone, on paper."""

import numpy as np
import pytest
from chromium import DESK, PHONE, logged, measured, needs_chromium, printed

from needleforce.plots import (
    Chart,
    Curve,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    palette,
    save_png,
    save_svg,
    write_page,
)

pytest.importorskip("matplotlib")
pytestmark = needs_chromium


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    x = np.linspace(0.0, 10.0, 3000)
    curve = Curve(style=palette.OURS, x=x, y=np.sin(x), label="a force")
    panel = Panel(y_label=palette.FORCE, curves=(curve,))
    chart = Chart(title="a chart", x_label=palette.TIME, panels=(panel,))
    paths = [save_svg(chart, folder / "a"), save_png(chart, folder / "a.png")]
    figures = tuple(PageFigure(path=path, alt=path.name, caption="What to see.") for path in paths)
    wide = PageTable(
        caption="Wide",
        head=tuple(f"a column called {k}" for k in range(30)),
        rows=(tuple("0.123456789" for _ in range(30)),) * 40,
    )
    sections = tuple(
        Section(
            heading=f"Part {k}",
            anchor=f"part-{k}",
            paragraphs=("`averylongwordwithoutaplacetobreak`" * 4,),
            figures=figures,
            tables=(wide,),
            command="python -m benchmarks run " + "one-scenario-after-the-other " * 20,
        )
        for k in range(3)
    )
    return write_page(folder / "index.html", Page(title="A page", sections=sections))


def test_nothing_is_logged(page):
    assert logged(page) == []


def test_a_resource_from_outside_would_be_noticed(page):
    text = page.read_text(encoding="utf-8")
    broken = page.with_name("broken.html")
    broken.write_text(text.replace("</main>", '<img src="lost.png"></main>'), encoding="utf-8")
    assert logged(broken)


@pytest.mark.parametrize("size", [PHONE, DESK], ids=["phone", "desk"])
def test_every_figure_is_seen_and_nothing_sticks_out(page, size):
    found = measured(page, size)
    assert found["window"] == size[0]
    assert found["content"] <= size[0]
    assert found["wide"] == []
    assert len(found["images"]) == 6
    assert all(image["natural"] > 0 and image["height"] > 100 for image in found["images"])
    assert found["letters"] >= 14.0


def test_on_a_phone_a_figure_is_as_wide_as_the_text(page):
    found = measured(page, PHONE)
    assert all(image["width"] > 0.85 * PHONE[0] for image in found["images"])


def test_it_prints(page, tmp_path):
    assert printed(page, tmp_path / "a.pdf") >= 2
