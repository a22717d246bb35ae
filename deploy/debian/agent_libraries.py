"""The shared libraries that the agents' packages carry, for robots of several releases.

The agents run on Debian 12, Ubuntu 22.04 and Ubuntu 24.04. The libraries that these have in common
stay the host's, and get the distribution's security updates. The others are copied from the Debian
packages of this machine into rips-agent-libs, where the agents' programs find them by their
DT_RPATH (RipsInstall.cmake).
"""

import os
import pathlib
import re
import shutil
import subprocess

PLACE = "usr/lib/rips/lib"
# Sonames: libraries that keep their ABI, in packages that each release has under the same name.
OF_THE_HOST = re.compile(
    r"(ld-linux.*|lib(c|m|dl|rt|pthread|resolv|gcc_s|stdc\+\+|ssl|crypto|z|acl|udev))\.so\.\d+")
# Cyclone DDS loads them by name when DDS Security is configured.
PLUGINS = ("libdds_security_ac.so", "libdds_security_auth.so", "libdds_security_crypto.so")
HEAD = f"""\
The shared libraries in /{PLACE}, and the Debian package each was copied
from. A distribution's security updates do not reach them: the next version of
RIPS does. Their licences are in /usr/share/doc/rips-agent-libs/licences; Debian
has the source of each, `apt-get source SOURCE=VERSION`.

"""


class Failed(Exception):
    """Why there are no packages."""


def run(*command, **options):
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False, **options)
    if done.returncode != 0:
        raise Failed(f"`{' '.join(words)}` failed:\n{done.stdout}{done.stderr}".rstrip())
    return done.stdout


def needed(programs):
    """Soname -> file on this machine, of all that the programs need but OF_THE_HOST."""
    # Whatever the caller's LD_LIBRARY_PATH says.
    text = run("ldd", *programs, env={"PATH": os.environ["PATH"], "LC_ALL": "C"})
    missing = re.findall(r"(\S+) => not found", text)
    if missing:
        raise Failed(f"this machine has no {', '.join(sorted(set(missing)))}")
    found = {soname: pathlib.Path(path).resolve()
             for soname, path in re.findall(r"(\S+) => (/\S+)", text)
             if not OF_THE_HOST.fullmatch(soname)}
    dds = next((path for soname, path in found.items() if soname.startswith("libddsc.so")), None)
    if dds:
        directory = next(dds.parent.glob("libddsc*debian"), dds.parent)
        found.update({name: directory / name for name in PLUGINS})
    return dict(sorted(found.items()))


def packages_of(files):
    """File -> name of the Debian package that has it."""
    owners = {}
    for line in run("dpkg-query", "-S", *files).splitlines():
        owner, _, path = line.partition(": ")
        owners[pathlib.Path(path)] = owner.partition(":")[0]
    return owners


def copy_libraries(programs, root):
    """Copies what `programs` need below `root`, with licences and the list LIBRARIES. Returns the
    names of the Debian packages."""
    files = needed(programs)
    owners = packages_of(files.values())
    place, doc = root / PLACE, root / "usr/share/doc/rips-agent-libs"
    place.mkdir(parents=True)
    (doc / "licences").mkdir(parents=True)
    for soname, file in files.items():
        shutil.copyfile(file, place / soname)
        # A DT_RUNPATH of its own would keep a library from using the program's DT_RPATH.
        run("patchelf", "--remove-rpath", place / soname)
    packages = sorted(set(owners.values()))
    for package in packages:
        shutil.copyfile(f"/usr/share/doc/{package}/copyright", doc / "licences" / package)
    (doc / "LIBRARIES").write_text(listing(files, owners, packages))
    return packages


def listing(files, owners, packages):
    """The text of LIBRARIES."""
    known = run("dpkg-query", "-W", "-f", "${Package} ${Version} ${source:Package} "
                "${source:Version}\n", *packages)
    versions = {line.split()[0]: line.split()[1:] for line in known.splitlines()}
    rows = [("LIBRARY", "PACKAGE", "VERSION", "SOURCE=VERSION")]
    for soname, file in files.items():
        version, source, of_source = versions[owners[file]]
        rows.append((soname, owners[file], version, f"{source}={of_source}"))
    widths = [max(map(len, column)) for column in zip(*rows)]
    return HEAD + "".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() + "\n"
        for row in rows)
