"""The public face of the package."""

import pytest

import urdf


def test_every_public_name_resolves_and_is_documented():
    assert len(set(urdf.__all__)) == len(urdf.__all__)
    for name in urdf.__all__:
        assert getattr(urdf, name).__doc__


@pytest.mark.parametrize("name", [n for n in urdf.__all__ if n.endswith("Error")])
def test_one_base_catches_every_error(name):
    assert issubclass(getattr(urdf, name), urdf.UrdfError)
