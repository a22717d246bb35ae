"""A copy of a root directory that a test can install packages into: an overlay in memory.

It belongs in a process that APART has started, which has namespaces of its own, also of networks
and processes: what is mounted and written is gone with that process.
"""

import pathlib
import shutil
import subprocess

from fleet import Skipped, check

LIMIT = 120  # seconds a command may take on a busy machine
APART = ["unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", "--propagation",
         "private"]


def run(*command, ok=True, timeout=LIMIT, **options):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, timeout=timeout, **options)
    check(not ok or done.returncode == 0,
          f"`{' '.join(map(str, command))}` ended with {done.returncode}:\n{done.stdout}")
    return done


class Overlay:
    def __init__(self, place, lower="/"):
        """`place` is an empty directory, `lower` the root directory to copy."""
        run("mount", "-t", "tmpfs", "rips-test", place)
        for name in ("upper", "work", "root"):
            (place / name).mkdir()
        self.root = pathlib.Path(place) / "root"
        options = f"lowerdir={lower},upperdir={place}/upper,workdir={place}/work"
        if run("mount", "-t", "overlay", "rips-test", "-o", options, self.root,
               ok=False).returncode != 0:
            raise Skipped("overlay file systems are not allowed here")
        run("mount", "-t", "proc", "proc", self.root / "proc")
        run("mount", "--rbind", "/dev", self.root / "dev")
        for name in ("run", "tmp"):
            run("mount", "-t", "tmpfs", "rips-test", self.root / name)
        (self.root / "tmp").chmod(0o1777)

    def run(self, *command, ok=True):
        return run("chroot", self.root, *command, ok=ok,
                   env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8",
                        "DEBIAN_FRONTEND": "noninteractive"})

    def install(self, packages):
        target = self.root / "tmp/packages"
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        for package in packages:
            shutil.copy(package, target)
        names = [f"/tmp/packages/{package.name}" for package in packages]
        return self.run("dpkg", "-i", *names).stdout

    def path(self, name):
        return self.root / name.lstrip("/")
