"""A container without an engine: a process in mount and PID namespaces of its own, on an unpacked
image that is mounted read-only, as the image's numeric user, without capabilities and, as under the
usual seccomp profile of engines, without a way to mount or to make namespaces. It shares the
network with its caller. As root, in a mount namespace that nothing else uses.

    container.py --enter SPECIFICATION    (what Container starts; its process becomes the program)
"""

import ctypes
import errno
import json
import os
import pathlib
import platform
import resource
import struct
import subprocess
import sys
import tarfile
import time

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "support"))
from fleet import Failed, Process, check  # noqa: E402

# Numbers of system calls: pivot_root, mount, unshare, clone, clone3.
PIVOT_ROOT, MOUNT, UNSHARE, CLONE, CLONE3 = {
    "x86_64": (155, 165, 272, 56, 435), "aarch64": (41, 40, 97, 220, 435)}[platform.machine()]
MNT_DETACH, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 2, 22, 2
NAMESPACES = 0x7E020000  # CLONE_NEWNS, NEWCGROUP, NEWUTS, NEWIPC, NEWUSER, NEWPID, NEWNET


def apply(layer, root):
    """Changes the directory `root` as the layer, a file, says."""
    with tarfile.open(layer) as archive:
        kept = []
        for member in archive.getmembers():
            place, _, name = member.name.rpartition("/")
            if name.startswith(".wh."):
                subprocess.run(["rm", "-r", root / place / name[4:]], check=True)
            else:
                kept.append(member)
        archive.extractall(root, kept, numeric_owner=True)


def unpack(layout, root):
    """Applies the layers of an image layout to the new directory `root`; its configuration."""
    def blob(descriptor):
        return layout / "blobs" / descriptor["digest"].replace(":", "/")
    manifest = json.loads(blob(json.loads((layout / "index.json").read_text())["manifests"][0])
                          .read_text())
    root.mkdir()
    for each in manifest["layers"]:
        apply(blob(each), root)
    return json.loads(blob(manifest["config"]).read_text())["config"]


class Container:
    """`mounts` are (SOURCE, TARGET, WRITABLE), SOURCE a file or a directory, or `tmpfs`."""

    def __init__(self, name, directory, root, config, mounts, *, args=(), limits=None,
                 user=None, groups=()):
        uid, gid = (user or config["User"]).split(":")
        self.setpriv = ["/usr/bin/setpriv", f"--reuid={uid}", f"--regid={gid}",
                        f"--groups={','.join(map(str, groups))}" if groups else "--clear-groups",
                        "--no-new-privs", "--bounding-set=-all", "--inh-caps=-all",
                        "--ambient-caps=-all"]
        self.env = dict(line.split("=", 1) for line in config["Env"])
        work = pathlib.Path(directory) / f"container-{name}"
        work.mkdir()
        specification = work / "specification.json"
        specification.write_text(json.dumps({
            "work": str(work), "root": str(root), "mounts": [list(map(str, m[:2])) + [m[2]]
                                                             for m in mounts],
            "limits": limits or {}, "env": self.env,
            "command": [*self.setpriv, *config["Entrypoint"], *args]}))
        self.process = Process(name, [
            "unshare", "--mount", "--pid", "--ipc", "--uts", "--fork", "--kill-child",
            sys.executable, "-B", __file__, "--enter", specification], directory)

    def pid(self):
        """Of the program, as its caller sees it."""
        child = self.process.child.pid
        file = pathlib.Path(f"/proc/{child}/task/{child}/children")
        deadline = time.monotonic() + 30  # until unshare has forked
        while self.process.running:
            children = file.read_text().split()
            if len(children) == 1:
                return int(children[0])
            check(time.monotonic() < deadline, f"{self.process.name} does not begin")
            time.sleep(0.02)
        raise Failed(f"{self.process.name} ended with {self.process.child.returncode}; it said\n"
                     + "\n".join(text for _, text in self.process.lines[-15:]))

    def run(self, command):
        """What an engine's `exec` does: the exit code, and what the command printed."""
        done = subprocess.run(["nsenter", f"--target={self.pid()}", "--mount", "--pid", "--root",
                               "--wd", *self.setpriv, *command], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, env=self.env, timeout=60)
        return done.returncode, done.stdout

    def stop(self, sig, seconds):
        """Its exit code, after a signal as an engine sends it."""
        os.kill(self.pid(), sig)
        try:
            return self.process.child.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.child.kill()
            raise Failed(f"{self.process.name} did not end within {seconds} s") from None


def mount(*words):
    subprocess.run(["mount", *map(str, words)], check=True)


def make_root(specification):
    """An overlay, so that the image stays as it is and mount points can be made in it, as engines
    do, before it becomes read-only."""
    work = pathlib.Path(specification["work"])
    mount("-t", "tmpfs", "rips-test", work)
    for name in ("upper", "work", "root"):
        (work / name).mkdir()
    root = work / "root"
    mount("-t", "overlay", "rips-test", "-o",
          f"lowerdir={specification['root']},upperdir={work}/upper,workdir={work}/work", root)
    mount("-t", "proc", "proc", root / "proc")
    mount("-t", "tmpfs", "-o", "mode=755", "rips-test", root / "dev")
    for name in ("null", "zero", "full", "random", "urandom"):
        (root / "dev" / name).touch()
        mount("--bind", f"/dev/{name}", root / "dev" / name)
    for source, target, writable in specification["mounts"]:
        place = root / target.lstrip("/")
        if source == "tmpfs":
            place.mkdir(parents=True, exist_ok=True)
            mount("-t", "tmpfs", "-o", "mode=1777,nosuid,nodev,noexec", "rips-test", place)
            continue
        if pathlib.Path(source).is_dir():
            place.mkdir(parents=True, exist_ok=True)
        else:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.touch()
        mount("--bind", source, place)
        if not writable:
            mount("-o", "remount,bind,ro", place)
    mount("-o", "remount,ro", root)
    return root


class Program(ctypes.Structure):
    """struct sock_fprog."""
    _fields_ = [("len", ctypes.c_ushort), ("filter", ctypes.c_char_p)]


def refuse_namespaces(libc):
    load, equal, any_bit, answer = 0x20, 0x15, 0x45, 0x06
    refuse, unknown, allow = 0x50000 | errno.EPERM, 0x50000 | errno.ENOSYS, 0x7FFF0000
    steps = [(load, 0, 0, 0),                # the number of the call
             (equal, 6, 0, MOUNT), (equal, 5, 0, UNSHARE), (equal, 3, 0, CLONE3),
             (equal, 0, 4, CLONE),
             (load, 0, 0, 16),               # the low half of its first argument
             (any_bit, 1, 2, NAMESPACES),
             (answer, 0, 0, unknown), (answer, 0, 0, refuse), (answer, 0, 0, allow)]
    code = b"".join(struct.pack("=HBBI", *step) for step in steps)
    program = Program(len(steps), code)
    if libc.prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, ctypes.byref(program), 0, 0) != 0:
        sys.exit(f"seccomp: {os.strerror(ctypes.get_errno())}")


def enter(specification):
    libc = ctypes.CDLL(None, use_errno=True)
    os.chdir(make_root(specification))
    # The old root is mounted over the new one, and then taken off.
    if libc.syscall(PIVOT_ROOT, b".", b".") != 0:
        sys.exit(f"pivot_root: {os.strerror(ctypes.get_errno())}")
    if libc.umount2(b".", MNT_DETACH) != 0:
        sys.exit(f"umount: {os.strerror(ctypes.get_errno())}")
    os.chdir("/")
    for name, value in specification["limits"].items():
        resource.setrlimit(getattr(resource, f"RLIMIT_{name.upper()}"), (value, value))
    refuse_namespaces(libc)
    command = specification["command"]
    os.execve(command[0], command, specification["env"])


if __name__ == "__main__":
    enter(json.loads(pathlib.Path(sys.argv[2]).read_text()))
