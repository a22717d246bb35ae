"""The OCI images of a build directory: what is in them, and that they run as deploy/compose.yaml
and deploy/kubernetes/policy-server.yaml say, in place of an engine in containers of container.py.

    images_test.py BUILD

As root. RIPS_IMAGES_BASE_ANEW=1 compares with images of a second Debian root, too.
"""

import gzip
import hashlib
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import urllib.error
import urllib.request

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path[:0] = [str(SOURCE / "deploy/oci"), str(SOURCE / "deploy/debian"),
                str(SOURCE / "tests/support")]
import layer  # noqa: E402
from container import Container, apply, unpack  # noqa: E402
from fleet import Failed, Skipped, check  # noqa: E402
from make_images import IMAGES, NotMade, make_images  # noqa: E402
from make_packages import QUICK, make_packages  # noqa: E402
from manifests import compose, kubernetes, version  # noqa: E402
from pages import commands_that  # noqa: E402
from root import APART, IDS, Failed as NoImage, NoRoot, Sources  # noqa: E402

LIMIT = 120  # seconds something may take on a busy machine
MEDIA = "application/vnd.oci.image."


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, timeout=LIMIT, **options)
    check(done.returncode == 0, f"`{' '.join(map(str, command))}` ended with {done.returncode}:\n"
                                f"{done.stdout}")
    return done.stdout


class World:
    """The images, each also as a layout: a directory."""

    def __init__(self, build, directory):
        self.build, self.dir = build, directory
        self.packages = directory / "packages"
        began = time.monotonic()
        make_packages(build, self.packages, QUICK)
        packed = time.monotonic()
        self.cache = build / "images"
        self.images = make_images(self.packages, directory / "images", self.cache)
        print(f"packages took {packed - began:.0f} s, "
              f"images {time.monotonic() - packed:.0f} s", flush=True)
        self.layouts = {}
        for image, (file, _) in self.images.items():
            self.layouts[image] = directory / "layouts" / image
            with tarfile.open(file) as archive:
                archive.extractall(self.layouts[image])


def blob_of(layout, descriptor, kind):
    """A blob, after a look at its descriptor."""
    check(set(descriptor) - {"annotations"} == {"mediaType", "digest", "size"},
          f"a descriptor has {set(descriptor)}")
    check(descriptor["mediaType"] == MEDIA + kind, f"{descriptor} is no {kind}")
    algorithm, _, digest = descriptor["digest"].partition(":")
    data = (layout / "blobs" / algorithm / digest).read_bytes()
    check(len(data) == descriptor["size"] and hashlib.sha256(data).hexdigest() == digest,
          f"{descriptor} is not what the blob is")
    return data


def images_follow_the_specification(world):
    """The image specification, version 1: layout, index, manifest, configuration, layers."""
    bases = set()
    for image, layout in world.layouts.items():
        check(json.loads((layout / "oci-layout").read_text()) == {"imageLayoutVersion": "1.0.0"},
              "oci-layout")
        index = json.loads((layout / "index.json").read_text())
        check(index["schemaVersion"] == 2 and index["mediaType"] == MEDIA + "index.v1+json"
              and len(index["manifests"]) == 1, f"{image}: {index}")
        descriptor, = index["manifests"]
        reference = f"localhost/{image}:{version()}"
        check(descriptor["annotations"]["org.opencontainers.image.ref.name"] == reference,
              f"{image}: {descriptor['annotations']}")
        check(descriptor["digest"] == world.images[image][1], f"{image} is another")
        manifest = json.loads(blob_of(layout, descriptor, "manifest.v1+json"))
        check(manifest["schemaVersion"] == 2 and manifest["mediaType"] == descriptor["mediaType"]
              and set(manifest) == {"schemaVersion", "mediaType", "config", "layers"},
              f"{image}: {manifest}")
        config = json.loads(blob_of(layout, manifest["config"], "config.v1+json"))
        layers = [blob_of(layout, each, "layer.v1.tar+gzip") for each in manifest["layers"]]
        bases.add(manifest["layers"][0]["digest"])
        check(config["rootfs"] == {"type": "layers", "diff_ids": [
            f"sha256:{hashlib.sha256(gzip.decompress(layer)).hexdigest()}" for layer in layers]},
            f"{image}: diff_ids")
        check(len(config["history"]) == len(layers), f"{image}: history")
        kept = {manifest["config"]["digest"], descriptor["digest"],
                *(each["digest"] for each in manifest["layers"])}
        there = {f"sha256:{path.name}" for path in (layout / "blobs/sha256").iterdir()}
        check(there == kept, f"{image} has blobs that belong to nothing")
        docker, = json.loads((layout / "manifest.json").read_text())
        check(docker["RepoTags"] == [reference] and [docker["Config"], *docker["Layers"]] == [
            "blobs/" + each["digest"].replace(":", "/")
            for each in (manifest["config"], *manifest["layers"])], f"{image}: manifest.json")
        check_configuration(image, config)
    check(len(bases) == 1, "the images do not share their base")


def check_configuration(image, config):
    check(set(config) == {"created", "architecture", "os", "config", "rootfs", "history"}
          and config["os"] == "linux", f"{image}: {set(config)}")
    user, ports, volumes = IMAGES[image]
    mine = config["config"]
    check(mine["User"] == f"{IDS[user]}:{IDS[user]}" and mine["StopSignal"] == "SIGTERM"
          and mine["Entrypoint"] == [f"/usr/bin/{image}"]
          and set(mine["Volumes"]) == set(volumes)
          and set(mine.get("ExposedPorts", ())) == {f"{port}/tcp" for port in ports},
          f"{image}: {mine}")
    labels = {key.rpartition(".")[2]: value for key, value in mine["Labels"].items()}
    check(labels["title"] == image and labels["version"] == version()
          and labels["licenses"] == "Apache-2.0" and labels["created"] == config["created"]
          and re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", config["created"]),
          f"{image}: {labels}")


def same_packages_same_bytes(world):
    anew = bool(os.environ.get("RIPS_IMAGES_BASE_ANEW"))
    cache = world.dir / "base" if anew else world.cache
    images = tuple(IMAGES) if anew else ("rips-sensor",)
    for image, (file, digest) in make_images(world.packages, world.dir / "again", cache,
                                             images).items():
        check(digest == world.images[image][1]
              and file.read_bytes() == world.images[image][0].read_bytes(),
              f"{image} differs from that of the first time")


def nothing_of_this_machine(world):
    """No host of a registry, no private key, no directory of the build, no machine's name."""
    hosts = [host.encode() for host in Sources().hosts()]
    key = re.compile(rb"-----BEGIN [A-Z ]*PRIVATE KEY-----\r?\n[A-Za-z0-9+/]")
    build = [str(path).encode() + b"/" for path in (SOURCE, world.build, world.dir)]
    for image, layout in world.layouts.items():
        for path in (layout / "blobs/sha256").iterdir():
            if path.read_bytes()[:2] != b"\x1f\x8b":
                continue
            with tarfile.open(path) as archive:
                for member in archive:
                    check_member(f"{image}: {member.name}", member)
                    if not member.isreg():
                        continue
                    data = archive.extractfile(member).read()
                    check(not key.search(data), f"{image}: {member.name} has a private key")
                    named = [word for word in (*hosts, *build) if word in data]
                    check(not named, f"{image}: {member.name} names {named}")


def check_member(what, member):
    check(not member.uname and not member.gname, f"{what} has names of owners")
    check(not member.isdev(), f"{what} is a device")
    check(not member.mode & 0o6000 or member.isdir() or member.uid == 0, f"{what}: mode")
    check(not re.search(r": (etc/(machine-id|hostname|resolv\.conf|apt/.)|root/\.ssh|"
                        r"var/(cache|lib/apt|log)/(?!rips)|tmp/|run/)", what),
          f"{what} should not be there")


def layers_say_what_changed(world):
    """A layer over a base, applied to the base, gives the root, whatever was changed, and how."""
    base, root, out = (world.dir / name for name in ("base root", "root", "out"))
    (base / "gone/below").mkdir(parents=True)
    (base / "gone/below/file").write_text("x")
    for name in ("same", "gone file", "rewritten", "chmod", "chown", "becomes a link"):
        (base / name).write_text(name)
    run("cp", "-a", base, root)
    shutil.rmtree(root / "gone")
    (root / "gone file").unlink()
    (root / "rewritten").write_text("REWRITTEN")  # as long as before
    (root / "chmod").chmod(0o4755)
    os.chown(root / "chown", 10443, 7)
    (root / "becomes a link").unlink()
    (root / "becomes a link").symlink_to("/nowhere")
    (root / "new/empty").mkdir(parents=True)
    (root / f"new/{'long' * 50}-ä").write_text("new")
    os.link(root / "rewritten", root / "new/hard link")
    blob = layer.write(root, layer.scan(base), out, 7)
    check(blob.digest == f"sha256:{hashlib.sha256(out.read_bytes()).hexdigest()}"
          and blob.size == out.stat().st_size, "digest or size")
    with tarfile.open(out) as archive:
        names = archive.getnames()
        check(all(member.mtime == 7 for member in archive), "a time of now")
    check(names == sorted(names) and "same" not in names and ".wh.gone" in names, str(names))
    apply(out, base)
    check(layer.scan(base) == layer.scan(root), "the layer does not give the root")


def what_cannot_become_an_image_is_refused(world):
    """With a reason, and nothing is left."""
    packages, out = world.dir / "some packages", world.dir / "no images"
    packages.mkdir()
    sensor = next(world.packages.glob("rips-sensor_*"))
    server = next(world.packages.glob("rips-policy-server_*"))
    for why, files in {
            "one package rips-policy-server, and has 0": {},
            "one package rips-sensor, and has 2":
                {"rips-sensor_9.deb": sensor,
                 **{path.name: path for path in world.packages.iterdir()}},
            "one package rips-inspect, and has 0": {server.name: server},
            "`dpkg-deb` failed": {server.name: SOURCE / "README.md"}}.items():
        for old in packages.iterdir():
            old.unlink()
        for name, source in files.items():
            (packages / name).symlink_to(source)
        try:
            make_images(packages, out, world.dir / "no base")
        except NoImage as refused:
            check(why in str(refused), f"expected `{why}`: {refused}")
        else:
            raise Failed(f"no complaint that there is {why}")
        check(not out.exists() and not (world.dir / "no base").exists(), "something is left")


def they_run(world):
    apart = ["unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", "--mount-proc",
             "--propagation", "private"]
    if subprocess.run([*apart, "true"], capture_output=True, check=False).returncode != 0:
        raise Skipped("unshare is not allowed here")
    done = subprocess.run([*apart, sys.executable, "-B", __file__, "--inside", world.build,
                           world.dir], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          timeout=4 * LIMIT, check=False)
    check(done.returncode == 0, done.stdout)
    print(done.stdout, end="")


# What follows runs in namespaces of its own, also of networks and processes.


def commands_of_the_handbook():
    """What containers.md tells an administrator to type before an engine's commands."""
    return [command for command in commands_that("images", "deploy/handbook/containers.md")
            if command.split()[0] in ("mkdir", "cp", "install")]


def wait(condition, what, containers=()):
    deadline = time.monotonic() + LIMIT
    while not condition():
        ended = [each.process.name for each in containers if not each.process.running]
        check(not ended and time.monotonic() < deadline, f"{what}: not within {LIMIT} s; "
              f"ended: {ended}\n" + "\n".join(tail(each) for each in containers))
        time.sleep(0.1)


def tail(container):
    return "\n".join([f"--- {container.process.name}",
                      *(text for _, text in container.process.lines[-15:])])


class Inside:
    def __init__(self, build, directory):
        self.build, self.dir = build, directory
        self.rips = directory / "srv rips"
        run("ip", "link", "set", "lo", "up")
        self.prepare()
        self.compose = compose({"RIPS_DIR": str(self.rips)})
        self.roots = {}
        for image in IMAGES:
            root = directory / f"root-{image}"
            self.roots[image] = root, unpack(directory / "layouts" / image, root)

    def prepare(self):
        """Certificates, and what the handbook says of files."""
        work = self.dir / "work"
        work.mkdir()
        (work / "deploy").symlink_to(SOURCE / "deploy")
        (work / "rules").symlink_to(SOURCE / "rules")
        for what in ("init", "server ps1", "sensor r1 base", "actuator r1 base",
                     "operator admin alice"):
            run("bash", SOURCE / "deploy/pki/mint", "--dir", work / "fleet", "--trust-domain",
                "fleet.example", *what.split())
        for command in commands_of_the_handbook():
            run("bash", "-c", command.replace("/srv/rips", f"'{self.rips}'"), cwd=work)
        for name in ("sensor", "actuator"):
            path = self.rips / f"{name}.yaml"
            path.write_text(path.read_text().replace("policy.example", "127.0.0.1")
                            .replace("interface: eth0", "interface: lo"))

    def start(self, service):
        """A service of the compose file."""
        described = self.compose["services"][service]
        root, config = self.roots[described["image"].partition("/")[2].partition(":")[0]]
        check(described["read_only"] and described["cap_drop"] == ["ALL"], f"{service} may write")
        mounts = [("tmpfs", target, True) for target in described["tmpfs"]]
        for volume in described["volumes"]:
            source, target, *options = volume.split(":")
            if source in self.compose["volumes"]:  # begins with what the image has there
                place, there = self.dir / source, os.lstat(root / target.lstrip("/"))
                place.mkdir()
                os.chown(place, there.st_uid, there.st_gid)
                place.chmod(there.st_mode & 0o7777)
                source = place
            mounts.append((source, target, "ro" not in options))
        return Container(service, self.dir, root, config, mounts, limits=described["ulimits"])

    def ripsctl(self, *words):
        alice = self.dir / "work/fleet/operator/admin/alice"
        return subprocess.run(
            [self.build / "bin/ripsctl", "--server", "127.0.0.1:7443", "--cert",
             alice / "cert.pem", "--key", alice / "key.pem", "--ca", alice / "ca.pem", *words],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=LIMIT,
            check=False)

    def stop(self, container, seconds):
        began = time.monotonic()
        code = container.stop(signal.SIGTERM, seconds)
        check(code == 0, f"it ended with {code}\n{tail(container)}")
        return time.monotonic() - began


def seconds_of(service):
    return int(service["stop_grace_period"].rstrip("s"))


def fleet_of_the_compose_file(inside):
    service = inside.compose["services"]["policy-server"]
    health = service["healthcheck"]["test"]
    check(health[0] == "CMD", "how is health asked?")
    server = inside.start("policy-server")
    wait(lambda: server.run(health[1:])[0] == 0, "healthy", [server])
    code, said = server.run(["bash", "-c", "id -u; touch /var/lib/rips/x || touch /etc/x || "
                             "grep -E 'Cap(Prm|Eff|Bnd)|NoNewPrivs|Seccomp:' /proc/1/status"])
    user = IDS["rips-policy-server"]
    check(code == 0 and said.split()[0] == str(user) and said.count("Read-only file system") == 2
          and re.findall(r"Cap\w+:\s*(\w+)", said) == ["0" * 16] * 3
          and re.search(r"NoNewPrivs:\s*1\s+Seccomp:\s*2", said), f"in the container:\n{said}")
    listed = inside.ripsctl("robot", "list")
    check(listed.returncode == 0 and "r1" in listed.stdout, listed.stdout)
    agents = [inside.start("sensor"), inside.start("actuator")]
    wait(lambda: {"sensor", "actuator"} <= set(re.findall(
        r"/robot/r1/(sensor|actuator)/base", inside.ripsctl("agent", "list").stdout)),
        "connected agents", [server, *agents])
    for agent in agents:
        inside.stop(agent, seconds_of(inside.compose["services"][agent.process.name]))
    took = inside.stop(server, seconds_of(service))
    kept = sorted(path.name for path in (inside.dir / "policy-server-state").iterdir())
    check("state.db" in kept, f"the volume has {kept}")
    print(f"the server ended {took:.1f} s after SIGTERM")


def key_that_cannot_be_read(inside):
    """The daemon says which file, and is not healthy."""
    key = inside.rips / "pki/policy-server/key.pem"
    mode, owner = key.stat().st_mode & 0o7777, key.stat().st_gid
    os.chown(key, 0, 0)
    shutil.rmtree(inside.dir / "policy-server-state")
    shutil.rmtree(inside.dir / "policy-server-log")
    shutil.rmtree(inside.dir / "container-policy-server")
    server = inside.start("policy-server")
    server.process.wait_for(lambda line: "key.pem" in line and "ermission denied" in line, LIMIT,
                            "a message about the key")
    code, _ = server.run(inside.compose["services"]["policy-server"]["healthcheck"]["test"][1:])
    check(code != 0, "it is healthy without its key")
    inside.stop(server, 30)
    os.chown(key, 0, owner)
    key.chmod(mode)


def as_projected(inside, name, files, mode, group):
    """A volume as the kubelet makes it of a ConfigMap or Secret: links to files of one version."""
    place = inside.dir / "kubelet" / name
    data = place / "..2026_11_26_00_00_00.1"
    data.mkdir(parents=True)
    (place / "..data").symlink_to(data.name)
    for file, text in files.items():
        (data / file).write_text(text)
        (data / file).chmod(mode)
        os.chown(data / file, 0, group)
        (place / file).symlink_to(f"..data/{file}")
    return place


def server_of_kubernetes(inside):
    objects = kubernetes()
    spec = objects["StatefulSet", "rips-policy-server"]["spec"]
    pod = spec["template"]["spec"]
    container, = pod["containers"]
    group = pod["securityContext"]["fsGroup"]
    made = {name: value["data"] for (kind, name), value in objects.items() if kind == "ConfigMap"}
    for name, directory in (("rips-bundle-warehouse", SOURCE / "rules/warehouse"),
                            ("rips-policy-server-tls", inside.dir / "work/fleet/server/ps1")):
        made[name] = {path.name: path.read_text() for path in directory.iterdir()}
    places = {}
    for volume in pod["volumes"]:
        mine = volume.get("configMap") or volume.get("secret")
        places[volume["name"]] = "tmpfs" if not mine else as_projected(
            inside, volume["name"], made[mine.get("name") or mine["secretName"]],
            mine["defaultMode"], group)
    for claim in spec["volumeClaimTemplates"]:
        place = places[claim["metadata"]["name"]] = inside.dir / "claim"
        place.mkdir()
        os.chown(place, 0, group)
        place.chmod(0o2775)
    mounts = []
    for mount in container["volumeMounts"]:
        source = places[mount["name"]]
        if "subPath" in mount:
            source = (source / mount["subPath"]).resolve()
        mounts.append((source, mount["mountPath"], not mount.get("readOnly", False)))
    root, config = inside.roots["rips-policy-server"]
    context = pod["securityContext"]
    server = Container("kubernetes", inside.dir, root, config, mounts, args=container["args"],
                       user=f"{context['runAsUser']}:{context['runAsGroup']}", groups=[group])
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        get = container[probe]["httpGet"]
        wait(lambda url=f"http://127.0.0.1:{ports[get['port']]}{get['path']}": answers(url), probe,
             [server])
    listed = inside.ripsctl("robot", "list")
    check(listed.returncode == 0 and "r1" in listed.stdout, listed.stdout)
    shown = inside.ripsctl("rules", "status").stdout
    check("warehouse" in shown, f"it has no bundle:\n{shown}\n{tail(server)}")
    inside.stop(server, pod["terminationGracePeriodSeconds"])


def answers(url):
    try:
        with urllib.request.urlopen(url, timeout=5) as reply:
            return reply.status == 200
    except (urllib.error.URLError, OSError):
        return False


def play(build, directory):
    """In the namespaces. Everything that runs ends with them."""
    inside = Inside(build, directory)
    for step in (fleet_of_the_compose_file, key_that_cannot_be_read, server_of_kubernetes):
        try:
            step(inside)
            print(f"passed {step.__name__}")
        except (Failed, OSError, subprocess.TimeoutExpired) as why:
            print(f"FAILED {step.__name__}: {why}")
            return 1
    return 0


STEPS = (images_follow_the_specification, same_packages_same_bytes, nothing_of_this_machine,
         layers_say_what_changed, what_cannot_become_an_image_is_refused, they_run)


def perform(step, world):
    began = time.monotonic()
    try:
        step(world)
    except Skipped as skipped:
        print(f"skipped {step.__name__}: {skipped}")
    except (Failed, NoImage, OSError, subprocess.TimeoutExpired) as failed:
        print(f"FAILED {step.__name__}: {failed}")
        return False
    else:
        print(f"passed {step.__name__} in {time.monotonic() - began:.0f} s", flush=True)
    return True


def main():
    os.umask(0o022)
    if sys.argv[1] == "--inside":
        return play(pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3]))
    if os.geteuid() != 0:
        print("skipped images: only root can make Debian roots")
        return 77
    for program in ("mmdebstrap", "dpkg-shlibdeps"):
        if not shutil.which(program):
            print(f"skipped images: {program} is missing; deploy/oci/packages and "
                  "deploy/debian/packages list what is needed")
            return 77
    if subprocess.run([*APART, "true"], capture_output=True, check=False).returncode != 0:
        print("skipped images: unshare is not allowed here")
        return 77
    with tempfile.TemporaryDirectory(prefix="rips-images-test-") as directory:
        try:
            world = World(pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(directory))
        except NoRoot as why:
            print(f"skipped images: no Debian root can be made here: {why}")
            return 77
        except (NoImage, NotMade) as why:
            print(f"FAILED to make the images: {why}")
            return 1
        passed = [perform(step, world) for step in STEPS]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
