"""The files of an FMU beside its description, code and binaries: icon, manual, licences, what it needs on the host.

Places and names are those of FMI 2.0.3 and later, where licences and external dependencies belong to the documentation.
"""

from __future__ import annotations

from ndob_fmu.fmu.manual import TEXTS


def documentation_files(page: str, icon: bytes) -> dict[str, bytes]:
    """Return the contents of these files for an FMU with this manual (HTML) and icon (PNG)."""
    texts = {
        f"documentation/{path.relative_to(TEXTS).as_posix()}": path.read_text("utf-8") for path in TEXTS.rglob("*.txt")
    }
    texts["documentation/index.html"] = page
    return {"model.png": icon} | {name: text.encode() for name, text in texts.items()}
