"""Viewers that close with their test."""

import pytest

from needleforce import NeedleTool, load_lwr
from needleforce.scene import Viewer
from tests.needleforce.scene.insertions import plan


@pytest.fixture
def open_page():
    """Opens pages that show moments, and closes them at the end."""
    pages = []

    def make(*moments, scene=None, robot=None, **settings):
        robot = robot or load_lwr(payload=NeedleTool())
        page = Viewer(robot, scene or plan(), port=8601, **settings)
        pages.append(page)
        if moments:
            page.append(list(moments))
            page.show()
        return page

    yield make
    for page in pages:
        page.stop()
