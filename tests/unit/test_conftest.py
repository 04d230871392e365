"""The fixture that fails tests which leak tasks does so."""

from __future__ import annotations

import pytest

from tests.repository import ROOT

pytest_plugins = ["pytester"]
LEAKY = """
import asyncio

async def test_leaks():
    asyncio.get_running_loop().keep = asyncio.create_task(asyncio.sleep(60), name="forgotten")

async def test_keeps_order():
    await asyncio.create_task(asyncio.sleep(0))

def test_is_not_asynchronous():
    pass
"""


def test_a_leaked_task_fails_its_test(pytester: pytest.Pytester) -> None:
    pytester.makeconftest((ROOT / "tests" / "conftest.py").read_text(encoding="utf-8"))
    pytester.makepyfile(LEAKY)
    pytester.makeini("[pytest]\nasyncio_mode = auto\nasyncio_default_fixture_loop_scope = function\n")
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, errors=1)
    result.stdout.fnmatch_lines(["*the test left 1 tasks running: forgotten*"])
