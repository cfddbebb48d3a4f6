"""The native observer of a model in the user's cache folder: built once for a model, where a C compiler is found."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ndob_fmu.codegen.compile_model import compile_model
from ndob_fmu.errors import ModelError, UsageError
from ndob_fmu.fmu.fmu_description import FmuDescription
from ndob_fmu.interface.model_variables import observer_variables
from ndob_fmu.model.model import Model
from ndob_fmu.native.compile import has_compiler, this_platform
from ndob_fmu.native.observer import observer_code
from ndob_fmu.native.origin import ORIGIN, origin
from ndob_fmu.native.package import package
from ndob_fmu.support.kept_files import keep, kept


def kept_observer(model: Model, folder: Path, *, builds: bool) -> Path | None:
    """Write the native observer of a model that is kept into a folder and return its path.

    builds: whether one is built that is not kept yet, which takes some seconds

    It is None where there is none: no compiler is found, it fails, or the model has no C form.
    """
    path, target = folder / f"{model.name}Observer.fmu", this_platform()
    own = origin(model)
    key = f"observer-{hashlib.sha256(own + target.encode()).hexdigest()}"
    found = kept(key)
    if found is not None:
        path.write_bytes(found)
        return path
    if not builds or not has_compiler(target):
        return None
    variables = observer_variables(compile_model(model))
    described = FmuDescription(path.stem, model.description, variables, model.experiment)
    try:
        package(path, described, observer_code(model), {ORIGIN: own}, platforms=[target])
    except (UsageError, ModelError):
        return None
    keep(key, path.read_bytes())
    return path
