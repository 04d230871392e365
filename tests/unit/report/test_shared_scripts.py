"""The modules of panoexec/pages work as modules in the operator's page, and as classic scripts in the report."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from panoexec.report.page import shared_asset, shared_script

MODULES = [one.name for one in (files("panoexec") / "pages").iterdir() if one.name.endswith(".js")]


@pytest.mark.parametrize("name", MODULES)
def test_no_word_of_a_module_is_left_in_a_classic_script(name: str) -> None:
    assert not re.search(r"^\s*(import|export)\b", shared_script(name), re.MULTILINE)


@pytest.mark.parametrize("name", MODULES)
def test_a_module_imports_only_its_neighbours(name: str) -> None:
    imported = re.findall(r'^import \{[^}]+\} from "\./([\w.]+)";$', shared_asset(name), re.MULTILINE)
    assert set(imported) <= set(MODULES)
    assert len(imported) == len(re.findall(r"^import\b", shared_asset(name), re.MULTILINE))


def test_every_name_is_defined_once() -> None:
    names = [
        found
        for name in MODULES
        for found in re.findall(r"^export (?:const|class|function) (\w+)", shared_asset(name), re.MULTILINE)
    ]
    assert len(names) > 20
    assert len(set(names)) == len(names)
