"""Message classes of rips.v1, made from the protos once per process: pb("FwRequest")(...)."""

import functools
import pathlib
import subprocess
import sys
import tempfile

try:
    import google.protobuf  # noqa: F401
except ModuleNotFoundError:  # another Python than Debian's runs this
    sys.path.append("/usr/lib/python3/dist-packages")


@functools.cache
def pb(name):
    """The message class rips.v1.`name`."""
    for module in _modules():
        if hasattr(module, name):
            return getattr(module, name)
    raise KeyError(name)


@functools.cache
def _modules():
    proto = pathlib.Path(__file__).resolve().parents[2] / "proto"
    files = [str(path.relative_to(proto)) for path in sorted(proto.glob("rips/v1/*.proto"))]
    directory = tempfile.TemporaryDirectory(prefix="rips-protos.")
    subprocess.run(["protoc", f"-I{proto}", f"--python_out={directory.name}", *files], check=True)
    sys.path.insert(0, directory.name)
    try:
        return [__import__(path[:-6].replace("/", ".") + "_pb2", fromlist=["*"]) for path in files]
    finally:
        sys.path.remove(directory.name)
        directory.cleanup()
