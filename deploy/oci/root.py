"""Debian roots for images: a base of Debian's essential packages, and the packages of an image in
it. As root. Debian packages come from the sources of this machine's apt; none of its hosts, and
nothing else of this machine, stays in a root.
"""

import hashlib
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import tarfile

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
KEYRING = "/usr/share/keyrings/debian-archive-keyring.gpg"
# What rips-common asks for without the rest of systemd.
HELPERS = ("systemd-standalone-sysusers", "systemd-standalone-tmpfiles")
# Users and groups of deploy/sysusers have fixed numbers in images: files and volumes on a host are
# given to a number. Above 10,000, where hosts seldom have users.
IDS = {
    "rips": 10440,
    "rips-sensor": 10441,
    "rips-exec": 10442,
    "rips-policy-server": 10443,
    "rips-fw": 10444,
    "rips-plugin": 10445,
    "rips-alarm": 10446,
}
# Left out as dpkg unpacks.
UNUSED = ("path-exclude=/usr/share/man/*", "path-exclude=/usr/share/locale/*",
          "path-exclude=/usr/share/doc/*", "path-include=/usr/share/doc/*/copyright")
# Emptied: what an engine mounts over, caches and logs, and what names this machine or its sources.
EMPTIED = ("dev", "etc/apt", "proc", "run", "sys", "tmp", "var/cache", "var/lib/apt", "var/log")
REMOVED = ("etc/hostname", "etc/machine-id", "etc/resolv.conf", "etc/passwd-", "etc/group-",
           "etc/shadow-", "etc/gshadow-", "etc/.pwd.lock", "var/lib/dpkg/status-old",
           "var/lib/dpkg/available-old", "var/lib/dpkg/diversions-old",
           "var/lib/dpkg/statoverride-old", "var/lib/dpkg/lock", "var/lib/dpkg/lock-frontend",
           "var/lib/dpkg/triggers/Lock", "var/lib/dbus/machine-id")
# What dpkg of a root runs in.
APART = ("unshare", "--mount", "--net", "--ipc", "--uts", "--pid", "--fork", "--kill-child")


class Failed(Exception):
    """Why there is no image."""


class NoRoot(Failed):
    """Debian's packages cannot be had."""


def run(*command, **options):
    words = [str(word) for word in command]
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          **options)
    if done.returncode != 0:
        last = "\n".join(done.stdout.splitlines()[-20:])
        raise Failed(f"`{words[0]}` failed with {done.returncode}:\n{last}")
    return done.stdout


def field(package, name):
    return run("dpkg-deb", "--field", package, name).strip()


class Sources:
    """The Debian suites that this machine's apt reads: the release, its updates, its security."""

    def __init__(self):
        release = pathlib.Path("/etc/os-release").read_text(encoding="utf-8")
        self.codename = re.search(r"^VERSION_CODENAME=(\w+)", release, re.M)[1]
        kept = {self.codename, f"{self.codename}-updates", f"{self.codename}-security"}
        self.lines, self.lists = [], []
        for line in run("apt-get", "indextargets", "--format",
                        "$(REPO_URI) $(RELEASE) $(COMPONENT) $(CODENAME) $(FILENAME)",
                        "Created-By: Packages", "Origin: Debian").splitlines():
            uri, suite, component, codename, file = line.split(maxsplit=4)
            if codename in kept and component == "main":
                self.lines.append(f"deb [signed-by={KEYRING}] {uri} {suite} {component}\n")
                self.lists.append(pathlib.Path(file))
        if not self.lines:
            raise NoRoot(f"apt knows no Debian source for {self.codename}; try `apt-get update`")

    def hosts(self):
        """Of which none may stand in an image."""
        return sorted({re.sub(r"^.*://([^/@]*@)?([^/:]+).*", r"\2", line.split()[2])
                       for line in self.lines})

    def state(self):
        """Changes when apt has other lists."""
        for path in sorted(self.lists):
            for file in sorted(path.parent.glob(path.name + "*")):
                yield f"{file.name} {file.stat().st_size} {file.stat().st_mtime_ns}\n"


def packages_of(image, packages):
    """The RIPS packages of an image, and what they need of Debian, from their control fields."""
    mine, needed, waiting = {}, set(HELPERS), [image]
    while waiting:
        name = waiting.pop()
        if name in mine:
            continue
        found = sorted(packages.glob(f"{name}_*.deb"))
        if len(found) != 1:
            raise Failed(f"{packages} must have one package {name}, and has {len(found)}")
        mine[name] = found[0]
        wanted = f"{field(found[0], 'Depends')}, {field(found[0], 'Pre-Depends')}"
        for alternatives in filter(None, (each.strip() for each in wanted.split(","))):
            names = [re.match(r"[a-z0-9.+-]+", each.strip())[0]
                     for each in alternatives.split("|")]
            if names[0].startswith("rips-"):
                waiting.append(names[0])
            elif not set(names) & set(HELPERS):
                needed.add(names[0])
    return sorted(mine.values()), sorted(needed)


class Base:
    """The root that images share, and the Debian packages that each adds, kept in a cache until
    apt has other lists or an image needs other packages."""

    def __init__(self, needed, cache, time):
        self.time = time
        sources = Sources()
        key = hashlib.sha256(pathlib.Path(__file__).read_bytes())
        key.update("".join([*sources.lines, *sources.state(), repr(needed), str(time)]).encode())
        self.directory = cache / key.hexdigest()[:16]
        if not self.directory.is_dir():
            self._make(needed, sources)

    def _make(self, needed, sources):
        for old in self.directory.parent.glob("[0-9a-f]*"):
            if re.fullmatch(r"[0-9a-f]{16}(\.part)?", old.name):
                shutil.rmtree(old)
        part = self.directory.with_suffix(".part")
        part.mkdir(parents=True)
        command = ["mmdebstrap", "--variant=essential", "--mode=root",
                   "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr"]
        command += [f"--dpkgopt={option}" for option in UNUSED]
        for image, names in sorted(needed.items()):
            (part / image).mkdir()
            fetch = shlex.join(["apt-get", "-q", "--yes", "--no-install-recommends",
                                "--download-only", "-o", f"Dir::Cache::archives={part / image}",
                                "install", *names])
            command.append(f'--customize-hook=APT_CONFIG="$MMDEBSTRAP_APT_CONFIG" {fetch}')
        try:
            run(*command, sources.codename, part / "base.tar", "-", input="".join(sources.lines),
                env={**os.environ, "SOURCE_DATE_EPOCH": str(self.time)})
        except Failed as why:
            raise NoRoot(str(why)) from why
        part.rename(self.directory)

    def unpack(self, root):
        """The base into the new directory `root`."""
        root.mkdir(mode=0o755)
        with tarfile.open(self.directory / "base.tar") as archive:
            archive.extractall(root, numeric_owner=True)

    def libraries(self, image):
        return sorted((self.directory / image).glob("*.deb"))


def numbered_users():
    """deploy/sysusers with the numbers of images."""
    for line in (SOURCE / "deploy/sysusers/rips.conf").read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition(" ")
        if kind in ("u", "g"):
            name, dash, rest = re.match(r"(\S+) +(\S+)(.*)", rest).groups()
            if name not in IDS or dash != "-":
                raise Failed(f"deploy/oci/root.py has no number for `{name}` of deploy/sysusers")
            line = f"{kind} {name} {IDS[name]}{rest}"
        yield line + "\n"


def install(root, packages, time):
    """Installs the packages in the root, without a network and without systemd."""
    place = root / "tmp/packages"
    place.mkdir()
    for package in packages:
        shutil.copy(package, place)
    users = root / "etc/sysusers.d/rips.conf"  # in place of that of rips-common
    users.parent.mkdir(exist_ok=True)
    users.write_text("".join(numbered_users()))
    names = [f"/tmp/packages/{package.name}" for package in packages]
    run(*APART, f"--mount-proc={root / 'proc'}", "chroot", root, "dpkg", "--force-unsafe-io",
        "--install", *names,
        env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8",
             "DEBIAN_FRONTEND": "noninteractive", "SOURCE_DATE_EPOCH": str(time)})


def clean(root, kept=()):
    """Takes out what an image must not have; `kept` are directories in emptied ones."""
    for name in EMPTIED:
        for path in (root / name).iterdir() if (root / name).is_dir() else ():
            if str(path.relative_to(root)) in kept:
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
    for name in REMOVED:
        (root / name).unlink(missing_ok=True)
