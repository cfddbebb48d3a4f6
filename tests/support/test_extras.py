"""What is told of an extra that is not installed, and what is not its absence."""

from __future__ import annotations

import pytest

from ndob_fmu.support.extras import extra


@pytest.mark.parametrize("missing", ["absent_from_here", "json.absent_from_here"])
def test_a_module_that_an_installed_package_misses_is_not_told_as_a_missing_extra(tmp_path, monkeypatch, missing):
    (tmp_path / "installed_package.py").write_text(f"import {missing}")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="absent_from_here"), extra("study"):
        import installed_package  # noqa: F401
