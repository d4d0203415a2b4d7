"""The page of a plan, or of an insertion by it: pictures, table, and the 3-D scene."""

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from needleforce import plots


def write_plan_page(
    folder: Path,
    title: str,
    lead: str,
    table: plots.PageTable,
    pictures: Mapping[str, Path],
    draw_scene: Callable[[Path], object],
    *,
    paragraphs: Sequence[str] = (),
    notices: Sequence[str] = (),
) -> None:
    """Write a page into a folder; without viser it has no 3-D scene beside it.

    Args:
        folder: The folder.
        title: Of the page.
        lead: What stands at its head.
        table: The result.
        pictures: Files by what they show.
        draw_scene: Writes the scene into a file.
        paragraphs: What stands above the table.
        notices: What is doubtful.
    """
    scene = folder / "scene.html"
    in_space = "In 3-D: not drawn, the extra `scene` is not installed."
    if find_spec("viser") is not None:
        draw_scene(scene)
        in_space = f"In 3-D: open `{scene.name}` in the same folder."
    figures = [
        plots.PageFigure(path=picture, alt=caption, caption=caption)
        for caption, picture in pictures.items()
    ]
    section = plots.Section(
        heading="Plan",
        anchor="plan",
        paragraphs=(*paragraphs, in_space),
        notices=tuple(notices),
        figures=tuple(figures),
        tables=(table,),
    )
    page = plots.Page(title=title, lead=(lead,), sections=(section,))
    plots.write_page(folder / plots.PAGE, page)
