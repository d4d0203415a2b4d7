"""The table of deliberate faults fits the project as it is."""

import re

import pytest
from msgspec.structs import replace

from foundation.errors import NeedleforceError
from tests.mutations import read_mutations
from tests.source_files import ROOT

MUTATIONS = read_mutations()


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_fault_changes_one_place_and_names_tests_that_exist(name):
    mutation = MUTATIONS[name]

    assert mutation.text() != (ROOT / mutation.file).read_text(encoding="utf-8")
    for test in mutation.tests:
        file, _, function = test.partition("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not function or re.search(rf"^def {function}\(", text, re.MULTILINE)


def test_a_fault_whose_place_has_gone_is_refused():
    fault = replace(next(iter(MUTATIONS.values())), old="gone")
    with pytest.raises(NeedleforceError, match="0 times, expected 1"):
        fault.text()
