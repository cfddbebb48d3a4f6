"""Find the model that the user means: a built-in one by name, or a Python file."""

from __future__ import annotations

import importlib
import re
import runpy
import traceback
import zipfile
from dataclasses import fields
from pathlib import Path

from ndob_fmu.errors import ModelError, NdobError, nearest, some_of
from ndob_fmu.model.model import Model
from ndob_fmu.runtime.equations import Experiment, ObserverDefaults, SignalDefaults
from ndob_fmu.support.progress import begin

BUILT_IN = ("flexible_joint",)


def load_model(source: str | Path) -> Model:
    """Return the built-in model of that name, or the `model` that a Python file defines.

    Raises ModelError where there is no such name or file, or where the file does not define a Model.
    """
    if str(source) in BUILT_IN:
        built_in: Model = importlib.import_module(f"ndob_fmu.model.built_in.{source}").model
        return built_in
    begin(f"running {source}")
    path = Path(source)
    if not path.is_file():
        raise ModelError.report(
            "MODEL",
            expected=f"a built-in name ({some_of(BUILT_IN)}) or the path of a Python file that defines `model`",
            received=repr(str(source)),
            likely="a misspelt name, or another working directory",
        )
    if zipfile.is_zipfile(path):
        raise ModelError.report(
            str(path),
            expected="a Python file that defines `model`",
            received="an archive",
            likely="an FMU or a system package, which `check` (.ssp) and `simulate` take",
        )
    try:
        model = runpy.run_path(str(path)).get("model")
    except NdobError as error:
        raise ModelError(f"{path}: {error}") from error
    except (Exception, SystemExit) as error:  # a user's file can raise anything
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = error.lineno if isinstance(error, SyntaxError) else (lines or [None])[-1]
        raise ModelError.report(
            str(path),
            expected="a Python file that runs",
            received=" ".join(f"{type(error).__name__}: {error}".split()) + (f" (line {line})" if line else ""),
            likely=_likely_field(error) or _likely_function(error),
        ) from error
    if not isinstance(model, Model):
        raise ModelError.report(
            str(path),
            expected="a file that defines `model = Model(...)`",
            received="no `model`" if model is None else f"`model` of type {type(model).__name__}",
        )
    return model


def _likely_field(error: BaseException) -> str:
    """Return the likely cause of a field that a model, or a part of it, does not have; empty for other errors."""
    found = re.search(r"(\w+)\.__init__\(\) got an unexpected keyword argument '(\w+)'", str(error))
    known = {of.__name__: of for of in (Model, ObserverDefaults, SignalDefaults, Experiment)}
    if not found or found[1] not in known:
        return ""
    names = [field.name for field in fields(known[found[1]]) if field.init]
    return nearest(found[2], names) or f"the fields are {some_of(names)}"


def _likely_function(error: BaseException) -> str:
    """Return the likely cause of a function that SymPy has and the file does not; empty for other errors."""
    found = re.match(r"cannot import name '(\w+)' from 'ndob_fmu'|name '(\w+)' is not defined", str(error))
    name = "" if found is None else found[1] or found[2]
    return f"`from sympy import {name}` is missing" if name and hasattr(importlib.import_module("sympy"), name) else ""
