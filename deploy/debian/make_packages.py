"""Makes the Debian packages of deploy/debian/control from a build directory.

    make_packages.py BUILD OUT

CMake's install rules (deploy/cmake/RipsInstall.cmake) say which file belongs to which package; this
adds manual pages, completion, copyright, changelog, the libraries of the agents
(agent_libraries.py) and the control files. The same build gives the same bytes on a machine with
the same libraries: every file has the time of the changelog and belongs to root, and tar sorts the
names. Packages appear in OUT whole or not at all; those of other versions stay.
"""

import argparse
import email.utils
import gzip
import hashlib
import os
import pathlib
import re
import shutil
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path.insert(0, str(HERE))
from agent_libraries import Failed, copy_libraries, run  # noqa: E402
from manual_page import manual_page, section  # noqa: E402

SCRIPTS = ("postinst", "prerm", "postrm")
LIBRARIES = "rips-agent-libs"  # the package of the agents' libraries; agents depend on it
SMALL, QUICK = 6, 1  # how much xz compresses: what ships; what tests make, in a ninth of the time


def paragraphs():
    """Of deploy/debian/control: a dict of fields each, the first of the source."""
    for text in (HERE / "control").read_text(encoding="utf-8").strip().split("\n\n"):
        yield dict(re.findall(r"^([A-Z][\w-]*): ((?:.*)(?:\n .*)*)", text, re.M))


def version_and_time():
    """Of the changelog, whose version must be CMake's."""
    text = (HERE / "changelog").read_text(encoding="utf-8")
    version = re.match(r"rips \(([0-9.]+)\) ", text)
    cmake = (SOURCE / "CMakeLists.txt").read_text(encoding="utf-8")
    project = re.search(r"^project\(rips VERSION ([0-9.]+)", cmake, re.M)
    if not version or not project or version[1] != project[1]:
        raise Failed("deploy/debian/changelog must begin with the version of CMakeLists.txt, "
                     f"{project and project[1]}")
    stamp = re.search(r"^ -- .*?  (.+)$", text, re.M)
    return version[1], int(email.utils.parsedate_to_datetime(stamp[1]).timestamp())


class Package:
    def __init__(self, fields, common, build, version, time, work):
        self.name = fields["Package"]
        self.fields, self.common = fields, common
        self.build, self.version, self.time = build, version, time
        self.root = work / self.name
        self.doc = self.root / "usr/share/doc" / self.name
        self.carried = []  # Debian packages whose libraries LIBRARIES has

    @property
    def is_agent(self):
        return LIBRARIES in self.fields.get("Depends", "")

    def path(self, name):
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def write_compressed(self, name, text):
        with open(self.path(name), "wb") as file:
            with gzip.GzipFile("", "wb", 9, file, mtime=0) as packed:
                packed.write(text.encode())

    def stage(self):
        run("cmake", "--install", self.build, "--component", self.name, "--prefix", "/usr",
            "--strip", env={**os.environ, "DESTDIR": str(self.root)})
        for program in sorted((self.root / "usr/bin").glob("*")):
            self.add_manual_page(program)
        if self.name == "rips-policy-server":
            self.add_camera_guard()
        overrides = HERE / f"{self.name}.lintian-overrides"
        if overrides.is_file():
            shutil.copyfile(overrides, self.path(f"usr/share/lintian/overrides/{self.name}"))
        own = HERE / f"{self.name}.copyright"
        shutil.copyfile(own if own.is_file() else HERE / "copyright",
                        self.path(self.doc / "copyright"))
        self.write_compressed(self.doc / "changelog.gz",
                              (HERE / "changelog").read_text(encoding="utf-8"))

    def add_manual_page(self, program):
        name = program.name
        if name == "ripsctl":
            self.write_compressed("usr/share/man/man1/ripsctl.1.gz", run(program, "man"))
            self.path("usr/share/bash-completion/completions/ripsctl").write_text(
                run(program, "completion", "bash"))
            return
        shown = None if name in ("rips-inspect", "rips-scan") else run(program, "--help")
        number = section(name)
        self.write_compressed(f"usr/share/man/man{number}/{name}.{number}.gz",
                              manual_page(name, self.version, shown))

    def add_camera_guard(self):
        """The bundle with a compiled plugin. Its manifest has the hash of the stripped program."""
        plugin = self.root.parent / "rips-plugin-blinding"
        shutil.copyfile(self.build / "bin/rips-plugin-blinding", plugin)
        run("strip", plugin)
        run("cmake", "-D", f"SOURCE={SOURCE / 'rules/camera_guard'}",
            "-D", f"BUNDLE={self.path('usr/lib/rips/bundles/camera-guard')}",
            "-D", f"PLUGIN={plugin}", "-D", "PLUGIN_ID=blinding",
            "-P", SOURCE / "deploy/cmake/RipsBundle.cmake")

    def files(self):
        return sorted(path for path in self.root.rglob("*")
                      if path.is_file() and self.root / "DEBIAN" not in path.parents)

    def programs(self):
        """And shared libraries."""
        return [path for path in self.files() if path.read_bytes()[:4] == b"\x7fELF"]

    def library_packages(self):
        """What dpkg-shlibdeps finds out; it wants the control file of a source package."""
        programs = self.programs()
        if not programs:
            return ""
        with tempfile.TemporaryDirectory() as directory:
            (pathlib.Path(directory) / "debian").mkdir()
            (pathlib.Path(directory) / "debian/control").write_text(
                f"Source: rips\n\nPackage: {self.name}\nArchitecture: any\n")
            found = run("dpkg-shlibdeps", "-O", *[f"-x{name}" for name in self.carried],
                        *[f"-e{program}" for program in programs], cwd=directory)
        return found.partition("=")[2].strip()

    def control(self, architecture):
        fields = {**self.fields, **{key: self.common[key] for key in
                                    ("Source", "Maintainer", "Section", "Priority")}}
        fields["Version"] = self.version
        fields["Architecture"] = "all" if fields["Architecture"] == "all" else architecture
        libraries = self.library_packages()
        for key in ("Depends", "Recommends"):
            if key in fields:
                fields[key] = fields[key].replace("\n", "").replace(
                    "${shlibs:Depends}", libraries).replace("${version}", self.version)
        kilobytes = sum(-(-path.stat().st_size // 1024) for path in self.files())
        directories = sum(1 for path in self.root.rglob("*") if path.is_dir())
        fields["Installed-Size"] = str(kilobytes + directories)
        order = ["Package", "Source", "Version", "Architecture", "Maintainer", "Installed-Size",
                 "Depends", "Recommends", "Suggests", "Section", "Priority", "Description"]
        return "".join(f"{key}: {fields[key]}\n" for key in order if key in fields)

    def write_control_files(self, architecture):
        control = self.control(architecture)
        files = {str(path.relative_to(self.root)): path for path in self.files()}
        sums = "".join(f"{hashlib.md5(path.read_bytes()).hexdigest()}  {name}\n"
                       for name, path in files.items())
        kept = "".join(f"/{name}\n" for name in files if name.startswith("etc/"))
        directory = self.root / "DEBIAN"
        directory.mkdir()
        (directory / "control").write_text(control)
        (directory / "md5sums").write_text(sums)
        if kept:
            (directory / "conffiles").write_text(kept)
        package = HERE / f"{self.name}.sh"
        for script in SCRIPTS if package.is_file() else ():
            parts = [HERE / "functions.sh", package, HERE / f"{script}.sh"]
            (directory / script).write_text(
                "#!/bin/sh\n" + "".join(part.read_text(encoding="utf-8") for part in parts))

    def normalise(self):
        """Modes and times that do not depend on who builds, or when."""
        scripts = {self.root / "DEBIAN" / script for script in SCRIPTS}
        for path in [self.root, *self.root.rglob("*")]:
            runs = path.is_dir() or path in scripts or (path.stat().st_mode & 0o100)
            path.chmod(0o755 if runs else 0o644)
            os.utime(path, (self.time, self.time))

    def build_into(self, out, architecture, level):
        self.write_control_files(architecture)
        self.normalise()
        mine = "all" if self.fields["Architecture"] == "all" else architecture
        name = f"{self.name}_{self.version}_{mine}.deb"
        part = out / f".{name}.part"
        run("dpkg-deb", "--root-owner-group", "--threads-max=1", "-Zxz", f"-z{level}",
            "--build", self.root, part,
            env={**os.environ, "SOURCE_DATE_EPOCH": str(self.time)})
        part.replace(out / name)
        return out / name


def make_packages(build, out, level=SMALL):
    """The packages made, in the order of the control file."""
    version, time = version_and_time()
    common, *packages = paragraphs()
    architecture = run("dpkg", "--print-architecture").strip()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="rips-packages-") as work:
        made = [Package(fields, common, build, version, time, pathlib.Path(work))
                for fields in packages]
        for package in made:
            package.stage()
        agents = [package for package in made if package.is_agent]
        libraries = next(package for package in made if package.name == LIBRARIES)
        carried = copy_libraries(
            [program for agent in agents for program in agent.programs()], libraries.root)
        for package in (*agents, libraries):
            package.carried = carried
        return [package.build_into(out, architecture, level) for package in made]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    args = parser.parse_args()
    os.umask(0o022)
    try:
        for package in make_packages(args.build.resolve(), args.out.resolve()):
            installed = int(run("dpkg-deb", "--field", package, "Installed-Size"))
            size = package.stat().st_size / 1e6
            print(f"    {size:5.1f} MB, {installed / 1e3:5.1f} MB installed: {package.name}")
    except (Failed, OSError) as why:
        sys.exit(f"error: {why}")


if __name__ == "__main__":
    main()
