"""The Python files that go inside an FMU, under names that no other FMU and no installed package can take.

All FMUs of one process share one interpreter: two that carried different code under one name would silently run the
first one's. Every bundled module is therefore named by a digest of its content.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from ndob_fmu import interface, runtime
from ndob_fmu.support.shipped import shipped_folder

_RUNTIME = Path(runtime.__file__).parent
_INTERFACE = Path(interface.__file__).parent
START_VALUES = "start_values.json"  # fmus/slave_start_values.py reads it


@dataclass(frozen=True)
class Bundle:
    """What an FMU carries in resources/.

    files: texts, by relative path
    entry: the path of the script that pythonfmu loads
    """

    files: Mapping[str, str]
    entry: str


def bundle(
    class_name: str,
    slave_module: str,
    slave_class: str,
    data_text: str = "",
    arguments: Sequence[str] = (),
    start_values: Mapping[str, float | int | bool | str] = MappingProxyType({}),
) -> Bundle:
    """Return the files of the FMU `class_name`, whose slave is `slave_class` of fmus/`slave_module`.py.

    `data_text` is a module that defines the `arguments` that the slave is made with, like EQUATIONS.
    `start_values` take the place of those that the slave has.
    """
    carried = {
        **_texts(_RUNTIME, "**/*.py"),
        **{f"interface/{name}": text for name, text in _texts(_INTERFACE, "*.py").items()},
        **_texts(shipped_folder("fmus"), "*slave*.py"),
    }
    package = f"ndob_runtime_{_digest(carried)}"
    data = f"ndob_equations_{_digest({'': data_text, 'package': package})}"

    def renamed(text: str) -> str:
        text = re.sub(r"(?m)^( *from )(?:ndob_fmu\.runtime|fmus)\b", rf"\1{package}", text)
        return re.sub(r"(?m)^( *from )ndob_fmu\.interface\b", rf"\1{package}.interface", text)

    files = {f"{package}/{name}": renamed(text) for name, text in carried.items()}
    files[START_VALUES] = json.dumps(dict(start_values), sort_keys=True, indent=1) + "\n"
    if arguments:
        files[f"{data}.py"] = renamed(data_text)
    modules = sorted(name.removesuffix(".py").replace("/", ".") for name in carried if "__init__" not in name)
    imports = "".join(f"        import {package}.{module}\n" for module in modules)
    entry_text = (
        f'"""Entry of {class_name}.fmu, which pythonfmu loads."""\n\n'
        # pythonfmu's binary runs this once more for every instance.
        f'if "{class_name}" in globals():\n'
        f'    {class_name} = globals()["{class_name}"]\n'
        f"    {package}.slave_entry.add_reference(globals())\n"
        f"else:\n"
        f"    import sys\n\n"
        # All of the package at once: it is found in the folder of the FMU that was loaded first, and that may be gone
        # by the time another FMU of the process asks for the rest. And if that folder is damaged none may go there.
        f"    try:\n"
        f"{imports}"
        + (f"        from {data} import {', '.join(arguments)}\n" if arguments else "")
        + f"        from {package}.{slave_module} import {slave_class}\n"
        f"    except BaseException:\n"
        f'        for name in [name for name in sys.modules if name.partition(".")[0] == "{package}"]:\n'
        f"            del sys.modules[name]\n"
        f"        raise\n\n"
        f"    class {class_name}({slave_class}):\n"
        f'        """The {slave_class} of this FMU."""\n\n'
        f"        def __init__(self, **kwargs):\n"
        f"            super().__init__({''.join(f'{name}, ' for name in arguments)}**kwargs)\n"
    )
    entry = f"{class_name}_{_digest(files | {'': entry_text})}.py"
    return Bundle(files={**files, entry: entry_text}, entry=entry)


def _texts(folder: Path, pattern: str) -> dict[str, str]:
    """Return the texts of the files that match, by their path below the folder."""
    return {path.relative_to(folder).as_posix(): path.read_text("utf-8") for path in sorted(folder.glob(pattern))}


def _digest(texts: Mapping[str, str]) -> str:
    whole = hashlib.sha256()
    for name in sorted(texts):
        whole.update(f"{name}\0{texts[name]}\0".encode())
    return whole.hexdigest()[:16]
