"""Makes the OCI images of RIPS from its Debian packages.

    make_images.py PACKAGES OUT --cache DIRECTORY

An image is one file, a tar of an OCI image layout, with the manifest.json that `docker load` reads.
It has two layers: the base of deploy/oci/root.py, the same in all, and the packages with their
libraries. The same packages and the same Debian give the same bytes. Images appear in OUT whole or
not at all.
"""

import argparse
import datetime
import hashlib
import json
import os
import pathlib
import shutil
import sys
import tarfile
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path[:0] = [str(HERE), str(SOURCE / "deploy/debian")]
import layer  # noqa: E402
from make_packages import Failed as NotMade, version_and_time  # noqa: E402
from root import IDS, Base, Failed, clean, field, install, packages_of, run  # noqa: E402

# No engine asks another host for a name that begins so.
PREFIX = "localhost"
ARCHITECTURES = {"amd64": "amd64", "arm64": "arm64"}  # Debian's -> OCI's
# IMAGE: its user, the ports that others connect to, and what must outlive a container.
IMAGES = {
    "rips-policy-server": ("rips-policy-server", (7443, 9464),
                           ("/var/lib/rips/policy-server", "/var/log/rips")),
    "rips-sensor": ("rips-sensor", (), ("/var/lib/rips/sensor",)),
    "rips-actuator": ("rips", (), ("/var/lib/rips/actuator",)),
}
LAYER = "application/vnd.oci.image.layer.v1.tar+gzip"
CONFIG = "application/vnd.oci.image.config.v1+json"
MANIFEST = "application/vnd.oci.image.manifest.v1+json"
INDEX = "application/vnd.oci.image.index.v1+json"


def configuration(image, title, version, created, blobs):
    user, ports, volumes = IMAGES[image]
    config = {
        "User": f"{IDS[user]}:{IDS[user]}",
        "Env": ["PATH=/usr/sbin:/usr/bin:/sbin:/bin"],
        "Entrypoint": [f"/usr/bin/{image}"],
        "WorkingDir": "/",
        "Volumes": {volume: {} for volume in volumes},
        "StopSignal": "SIGTERM",
        "Labels": {
            "org.opencontainers.image.title": image,
            "org.opencontainers.image.description": title,
            "org.opencontainers.image.version": version,
            "org.opencontainers.image.licenses": "Apache-2.0",
            "org.opencontainers.image.created": created,
        },
    }
    if ports:
        config["ExposedPorts"] = {f"{port}/tcp": {} for port in ports}
    architecture = run("dpkg", "--print-architecture").strip()
    if architecture not in ARCHITECTURES:
        raise Failed(f"OCI has no name here for Debian's architecture {architecture}")
    return {
        "created": created,
        "architecture": ARCHITECTURES[architecture],
        "os": "linux",
        "config": config,
        "rootfs": {"type": "layers", "diff_ids": [blob.diff_id for blob in blobs]},
        "history": [{"created": created, "created_by": text} for text in
                    ("Debian's essential packages", f"{image} {version} and what it needs")],
    }


class Layout:
    """A directory that becomes an image's archive."""

    def __init__(self, directory):
        self.directory = directory
        self.blobs = directory / "blobs/sha256"
        self.blobs.mkdir(parents=True)

    def add_layer(self, file, blob):
        os.link(file, self.blobs / blob.digest.partition(":")[2])
        return {"mediaType": LAYER, "digest": blob.digest, "size": blob.size}

    def add_json(self, media_type, value):
        data = json.dumps(value, sort_keys=True, separators=(",", ":")).encode()
        name = hashlib.sha256(data).hexdigest()
        (self.blobs / name).write_bytes(data)
        return {"mediaType": media_type, "digest": f"sha256:{name}", "size": len(data)}

    def write_json(self, name, value):
        (self.directory / name).write_text(json.dumps(value, sort_keys=True) + "\n")

    def finish(self, reference, config, layers):
        """Its manifest and index."""
        manifest = self.add_json(MANIFEST, {"schemaVersion": 2, "mediaType": MANIFEST,
                                            "config": config, "layers": layers})
        manifest["annotations"] = {"io.containerd.image.name": reference,
                                   "org.opencontainers.image.ref.name": reference}
        self.write_json("oci-layout", {"imageLayoutVersion": "1.0.0"})
        self.write_json("index.json", {"schemaVersion": 2, "mediaType": INDEX,
                                       "manifests": [manifest]})
        self.write_json("manifest.json", [{
            "Config": blob_path(config), "RepoTags": [reference],
            "Layers": [blob_path(each) for each in layers]}])
        return manifest["digest"]

    def pack(self, out, time):
        part = out.with_name(f".{out.name}.part")
        with tarfile.open(part, "w", format=tarfile.PAX_FORMAT) as archive:
            for path in sorted(self.directory.rglob("*")):
                info = archive.gettarinfo(path, arcname=str(path.relative_to(self.directory)))
                info.mtime, info.uid, info.gid, info.uname, info.gname = time, 0, 0, "", ""
                info.mode = 0o755 if path.is_dir() else 0o644
                with open(path, "rb") if path.is_file() else open(os.devnull, "rb") as file:
                    archive.addfile(info, file)
        part.replace(out)


def blob_path(descriptor):
    return "blobs/" + descriptor["digest"].replace(":", "/")


def make_images(packages, out, cache, images=tuple(IMAGES)):
    """IMAGE -> (file, digest of its manifest), in that order."""
    version, time = version_and_time()
    created = datetime.datetime.fromtimestamp(time, datetime.timezone.utc).strftime(
        "%Y-%m-%dT%H:%M:%SZ")
    parts = {image: packages_of(image, packages) for image in IMAGES}
    base = Base({image: needed for image, (_, needed) in parts.items()}, cache, time)
    out.mkdir(parents=True, exist_ok=True)
    made = {}
    with tempfile.TemporaryDirectory(prefix=".images-", dir=out) as work:
        work = pathlib.Path(work)
        base.unpack(work / "root")
        clean(work / "root")
        shared = layer.scan(work / "root")
        base_blob = layer.write(work / "root", {}, work / "base", time)
        for image, (mine, _) in parts.items():
            if image not in images:
                continue
            shutil.rmtree(work / "root")
            base.unpack(work / "root")
            install(work / "root", [*base.libraries(image), *mine], time)
            clean(work / "root", {volume.lstrip("/") for volume in IMAGES[image][2]})
            blob = layer.write(work / "root", shared, work / f"{image}.layer", time)
            layout = Layout(work / image)
            layers = [layout.add_layer(work / "base", base_blob),
                      layout.add_layer(work / f"{image}.layer", blob)]
            title = field(mine[[path.name.partition("_")[0] for path in mine].index(image)],
                          "Description").splitlines()[0]
            config = layout.add_json(CONFIG, configuration(image, title, version, created,
                                                           (base_blob, blob)))
            digest = layout.finish(f"{PREFIX}/{image}:{version}", config, layers)
            file = out / f"{image}_{version}.tar"
            layout.pack(file, time)
            made[image] = file, digest
    return made


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--cache", type=pathlib.Path, required=True)
    args = parser.parse_args()
    os.umask(0o022)
    try:
        for file, digest in make_images(args.packages.resolve(), args.out.resolve(),
                                        args.cache.resolve()).values():
            print(f"    {file.stat().st_size / 1e6:5.1f} MB: {file.name} {digest}")
    except (Failed, NotMade, OSError) as why:
        sys.exit(f"error: {why}")


if __name__ == "__main__":
    main()
