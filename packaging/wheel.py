#!/usr/bin/env python3
"""Makes the Python wheels: `scanloop`, of Python alone, and with an executable `scanloop-bin`.

usage: packaging/wheel.py VERSION OUT [EXECUTABLE TAG]

`scanloop` has the modules of examples/python: `scanloop`, `scanloop_types`, `scanloop.own_topics` for companions, `scanloop.person` and `scanloop.goal`.
With EXECUTABLE, a second wheel for the platform TAG puts it on the PATH of the environment.
Equal input gives equal files: members have one order and the time of SOURCE_DATE_EPOCH.
"""

import base64
import ctypes
import enum
import hashlib
import importlib.util
import os
import pathlib
import sys
import time
import zipfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
SOURCES = ROOT / "examples" / "python"
SUMMARY = "Processes for Scanloop: from a laser scan to a verified command, every process replaceable"
LICENCE = "MIT OR Apache-2.0"
LICENCES = ("LICENSE-MIT", "LICENSE-APACHE")
PYTHON = {"c_double": "float"}  # of ctypes; all other numbers are int


def of_ctypes(kind):
    """The type of a field in a stub."""
    if issubclass(kind, ctypes.Array):
        return f"ctypes.Array[{kind._type_.__name__ if issubclass(kind._type_, ctypes.Structure) else scalar(kind._type_)}]"
    return kind.__name__ if issubclass(kind, ctypes.Structure) else PYTHON.get(kind.__name__, "int")


def scalar(kind):
    """The name by which a scalar of an array is known: `ctypes.c_uint64` is an alias of another."""
    names = ("c_uint8", "c_uint16", "c_uint32", "c_uint64", "c_int32", "c_double")
    return next(f"ctypes.{name}" for name in names if getattr(ctypes, name) is kind)


def stub_of_class(name, kind):
    """The stub of an enumeration or of a structure."""
    if issubclass(kind, enum.Enum):
        return [f"class {name}(enum.IntEnum):", *(f"    {member.name} = {member.value}" for member in kind)]
    fields = [(field, of_ctypes(of)) for field, of in kind._fields_]
    constants = [(key, type(value).__name__) for key, value in vars(kind).items() if key.isupper() and key[0] != "_"]
    lines = [f"class {name}(ctypes.Structure):"]
    lines += [f"    {key}: typing.ClassVar[{of}]" for key, of in constants]
    lines += [f"    {field}: {of}" for field, of in fields]
    arguments = ", ".join(f"{field}: {of} = ..." for field, of in fields)
    lines.append(f"    def __init__(self, *, {arguments}) -> None: ...")
    if constants:
        lines += ["    @staticmethod", "    def type_name() -> str: ..."]
    return lines


def stub(module):
    """Types of `scanloop_types`, which ctypes hides from type checkers."""
    lines = ["import ctypes", "import enum", "import typing"]
    for name, value in vars(module).items():
        if name.startswith("_") or name in ("ctypes", "enum"):
            continue
        if isinstance(value, type):
            lines += ["", *stub_of_class(name, value)]
        elif isinstance(value, (int, float)):
            lines.append(f"{name}: typing.Final = {value!r}")
    samples = "type[ctypes.Structure]"
    lines += ["", f"TOPICS: dict[str, {samples}]", f"READS: dict[Role, list[{samples}]]", f"WRITES: dict[Role, list[{samples}]]"]
    lines.append("def layouts() -> list[tuple[str, str, str, int, int, int]]: ...")
    return "\n".join(lines) + "\n"


def types_module():
    """The module of the samples, imported."""
    spec = importlib.util.spec_from_file_location("scanloop_types", SOURCES / "scanloop_types.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write(out, name, version, tag, metadata, members):
    """Writes a wheel; `members` are pairs of path and bytes, of which scripts may be executed."""
    info = f"{name}-{version}.dist-info"
    pure = "true" if tag == "py3-none-any" else "false"
    # A tag of several platforms stands for one line each.
    python, abi, platforms = tag.split("-")
    tags = "".join(f"Tag: {python}-{abi}-{platform}\n" for platform in platforms.split("."))
    members = [
        *members,
        *((f"{info}/licenses/{file}", (ROOT / file).read_bytes()) for file in LICENCES),
        (f"{info}/METADATA", metadata.encode()),
        (f"{info}/WHEEL", f"Wheel-Version: 1.0\nGenerator: packaging/wheel.py\nRoot-Is-Purelib: {pure}\n{tags}".encode()),
    ]
    digest = lambda data: base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    record = "".join(f"{path},sha256={digest(data)},{len(data)}\n" for path, data in members) + f"{info}/RECORD,,\n"
    stamp = time.gmtime(max(int(os.environ.get("SOURCE_DATE_EPOCH", "315532800")), 315532800))[:6]
    file = out / f"{name}-{version}-{tag}.whl"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in [*members, (f"{info}/RECORD", record.encode())]:
            member = zipfile.ZipInfo(path, stamp)
            member.external_attr = (0o100755 if "/scripts/" in path else 0o100644) << 16
            member.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(member, data)
    return file


def metadata(name, version, *lines):
    """What an installer reads."""
    head = ["Metadata-Version: 2.4", f"Name: {name}", f"Version: {version}", f"Summary: {SUMMARY}"]
    head += [f"License-Expression: {LICENCE}", *(f"License-File: {file}" for file in LICENCES), *lines]
    return "\n".join(head) + "\n"


def main(version, out, executable=None, tag=None):
    """Writes the wheels and prints their names."""
    out = pathlib.Path(out)
    needs = [line for line in (SOURCES / "requirements.txt").read_text().splitlines() if line.startswith("iceoryx2")]
    read = lambda name: (SOURCES / name).read_bytes()
    members = [
        ("scanloop/__init__.py", read("scanloop.py")),
        ("scanloop/own_topics.py", read("own_topics.py")),
        ("scanloop/goal.py", read("goal.py")),
        ("scanloop/person.py", read("person.py")),
        ("scanloop/py.typed", b""),
        ("scanloop_types/__init__.py", read("scanloop_types.py")),
        ("scanloop_types/__init__.pyi", stub(types_module()).encode()),
        ("scanloop_types/py.typed", b""),
    ]
    lines = ["Requires-Python: >=3.11", *(f"Requires-Dist: {need}" for need in needs)]
    print(write(out, "scanloop", version, "py3-none-any", metadata("scanloop", version, *lines), members))
    if executable:
        script = (f"scanloop_bin-{version}.data/scripts/scanloop", pathlib.Path(executable).read_bytes())
        print(write(out, "scanloop_bin", version, tag, metadata("scanloop-bin", version), [script]))


if __name__ == "__main__":
    if len(sys.argv) not in (3, 5):
        sys.exit(__doc__)
    main(*sys.argv[1:])
