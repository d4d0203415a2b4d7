"""Every field of a configuration says what it cannot be."""

from dataclasses import fields

import numpy as np
import pytest

from identification.errors import InvalidConfigError
from identification.input_validation import CheckConfig
from identification.multilayer_config import MultilayerConfig
from identification.published_config import PublishedConfig

FIELDS = [
    (kind, field.name)
    for kind in (PublishedConfig, MultilayerConfig, CheckConfig)
    for field in fields(kind)
]


@pytest.mark.parametrize(("kind", "name"), FIELDS)
@pytest.mark.parametrize(
    "value", [None, "1", 1j, True, [1.0], np.ones(2), np.nan, np.inf, 10**400, {}]
)
def test_what_is_no_figure_is_refused(kind, name, value):
    with pytest.raises(InvalidConfigError, match=name):
        kind(**{name: value})


@pytest.mark.parametrize(("kind", "name"), FIELDS)
def test_its_own_value_is_welcome_as_a_numpy_scalar_too(kind, name):
    value = getattr(kind(), name)
    if isinstance(value, float | int):
        value = np.asarray(value)[()]
    assert getattr(kind(**{name: value}), name) == value


def test_windows_are_counted_in_whole_numbers():
    with pytest.raises(InvalidConfigError, match="most_windows"):
        PublishedConfig(most_windows=0.5)
