"""Layers of images: compressed tar files that depend on names, owners, modes and contents alone."""

import dataclasses
import gzip
import hashlib
import os
import stat
import tarfile


@dataclasses.dataclass(frozen=True)
class Entry:
    """What a layer says of a path. `content` is a hash, or where a symbolic link leads."""
    mode: int
    uid: int
    gid: int
    content: str


@dataclasses.dataclass(frozen=True)
class Blob:
    """A compressed layer; `diff_id` is the hash of what it was before."""
    digest: str
    diff_id: str
    size: int


def scan(root):
    """PATH below the root -> Entry, of everything."""
    found = {}
    for directory, folders, files in os.walk(root):
        for name in [*folders, *files]:
            path = os.path.join(directory, name)
            info = os.lstat(path)
            content = ""
            if stat.S_ISLNK(info.st_mode):
                content = os.readlink(path)
            elif stat.S_ISREG(info.st_mode):
                with open(path, "rb") as file:
                    content = hashlib.file_digest(file, "sha256").hexdigest()
            found[os.path.relpath(path, root)] = Entry(info.st_mode, info.st_uid, info.st_gid,
                                                       content)
    return found


class Hashing:
    """Hashes and counts what it passes on."""

    def __init__(self, out):
        self._out, self._hash, self.size = out, hashlib.sha256(), 0

    def write(self, data):
        self._hash.update(data)
        self.size += len(data)
        return self._out.write(data)

    def flush(self):
        self._out.flush()

    def digest(self):
        return f"sha256:{self._hash.hexdigest()}"


def write(root, base, out, time):
    """Writes what the root has beyond `base`, a scan, to the new file `out`; the Blob it is. What
    the root lacks of the base becomes a whiteout."""
    now = scan(root)
    names = [name for name, entry in now.items() if base.get(name) != entry]
    gone = {name for name in base if name not in now}
    whiteouts = [os.path.join(os.path.dirname(name), f".wh.{os.path.basename(name)}")
                 for name in gone if os.path.dirname(name) not in gone]
    with open(out, "wb") as file:
        packed = Hashing(file)
        with gzip.GzipFile("", "wb", 6, packed, mtime=0) as compressor:
            plain = Hashing(compressor)
            with tarfile.open(fileobj=plain, mode="w|", format=tarfile.PAX_FORMAT) as archive:
                for name in sorted([*names, *whiteouts]):
                    _add(archive, root, name, time, name in now)
    return Blob(packed.digest(), plain.digest(), packed.size)


def _add(archive, root, name, time, exists):
    if not exists:
        info = tarfile.TarInfo(name)
        info.mtime = time
        archive.addfile(info)
        return
    path = os.path.join(root, name)
    info = archive.gettarinfo(path, arcname=name)  # knows hard links
    info.mtime, info.uname, info.gname = time, "", ""
    if info.isreg():
        with open(path, "rb") as file:
            archive.addfile(info, file)
    else:
        archive.addfile(info)
