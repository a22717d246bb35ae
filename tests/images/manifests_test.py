"""deploy/compose.yaml and deploy/kubernetes/policy-server.yaml are valid, and say what the rest of
the project says.

They are compared with the compose specification's JSON schema, which Debian's docker-compose has,
and with the models of the Kubernetes API in Debian's python3-kubernetes, generated from its OpenAPI
schema. Both are older than today's, so the files keep to what these know. What is not installed is
named in a line that begins with `skipped`; the other checks need neither.
"""

import datetime
import json
import pathlib
import re
import sys

sys.path.append("/usr/lib/python3/dist-packages")  # another Python than Debian's
HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path[:0] = [str(HERE), str(SOURCE / "deploy/oci"), str(SOURCE / "tests/support")]
import yaml  # noqa: E402
from fleet import Failed, Skipped, check  # noqa: E402
from make_images import IDS, IMAGES  # noqa: E402
from manifests import COMPOSE, compose, kubernetes, version  # noqa: E402

SCHEMA = pathlib.Path("/usr/lib/python3/dist-packages/compose/config/compose_spec.json")
SERVICES = {"policy-server": "rips-policy-server", "sensor": "rips-sensor",
            "actuator": "rips-actuator"}


def server_configuration():
    return yaml.safe_load((SOURCE / "deploy/config/policy-server.yaml").read_text())


def unit(name):
    """KEY -> the last value of it in a unit of deploy/systemd."""
    text = (SOURCE / f"deploy/systemd/{name}.service").read_text(encoding="utf-8")
    return dict(re.findall(r"^(\w+)=(.*)$", text, re.M))


def compose_follows_its_schema():
    try:
        import jsonschema
    except ImportError:
        raise Skipped("python3-jsonschema is missing") from None
    if not SCHEMA.exists():
        raise Skipped("docker-compose, which has the schema, is missing")
    validator = jsonschema.Draft7Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))
    errors = [f"{list(error.path)}: {error.message}"
              for error in validator.iter_errors(compose({}))]
    check(not errors, f"{COMPOSE.name}:\n" + "\n".join(errors))
    broken = compose({})
    broken["services"]["sensor"]["read_olny"] = True
    check(list(validator.iter_errors(broken)), "the schema accepts a key that is none")


def compose_confines_each_service():
    file = compose({})
    check(set(file["services"]) == set(SERVICES), f"it has {set(file['services'])}")
    for name, image in SERVICES.items():
        service = file["services"][name]
        check(service["image"] == f"localhost/{image}:{version()}", f"{name}: {service['image']}")
        check(service["read_only"] is True and service["cap_drop"] == ["ALL"]
              and service["security_opt"] == ["no-new-privileges:true"]
              and "cap_add" not in service and "privileged" not in service
              and "user" not in service, f"{name} is not confined")
        limits = unit(image)
        check(service["mem_limit"].upper() == limits["MemoryMax"], f"{name}: mem_limit")
        check(service["pids_limit"] == int(limits["TasksMax"]), f"{name}: pids_limit")
        log = service["logging"]
        check(log["driver"] == "json-file" and log["options"].keys() == {"max-size", "max-file"},
              f"{name}: its log is not bounded: {log}")
        mounted = {target: source for source, target, *_ in
                   (volume.split(":") for volume in service["volumes"])}
        check(set(IMAGES[image][2]) | {"/etc/rips"} == set(mounted), f"{name} mounts {mounted}")
        check(all(source in file["volumes"] for source in mounted.values()
                  if not source.startswith("/")), f"{name}: a volume is not declared")
        check(("robot" in service.get("profiles", [])) == (name != "policy-server")
              and (service.get("network_mode") == "host") == (name != "policy-server"),
              f"{name}: profile or network")


def ports_are_those_of_the_configuration():
    configuration = server_configuration()
    listen, metrics = (int(configuration[key].rpartition(":")[2]) for key in ("listen", "metrics"))
    check(IMAGES["rips-policy-server"][1] == (listen, metrics), "ports of the image")
    server = compose({})["services"]["policy-server"]
    check(server["ports"] == [f"{listen}:{listen}", f"127.0.0.1:{metrics}:{metrics}"],
          f"compose publishes {server['ports']}")
    check(f"/127.0.0.1/{metrics};" in server["healthcheck"]["test"][-1],
          "health is asked elsewhere")
    objects = kubernetes()
    pod = objects["StatefulSet", "rips-policy-server"]["spec"]["template"]["spec"]
    named = {port["name"]: port["containerPort"] for port in pod["containers"][0]["ports"]}
    check(named == {"grpc": listen, "metrics": metrics}, f"the pod has {named}")
    for service, port in (("rips-policy-server", listen), ("rips-policy-server-metrics", metrics)):
        mine = objects["Service", service]["spec"]["ports"]
        check([each["port"] for each in mine] == [port] and mine[0]["targetPort"] in named, service)
    allowed = [each["ports"][0]["port"] for each in
               objects["NetworkPolicy", "rips-policy-server"]["spec"]["ingress"]]
    check(allowed == [listen, metrics], f"the policy allows {allowed}")
    files = objects["ConfigMap", "rips-policy-server"]["data"]
    inside = yaml.safe_load(files["policy-server.yaml"])
    for key, port in (("listen", listen), ("metrics", metrics)):
        check(inside[key] == f"0.0.0.0:{port}", f"the ConfigMap has {key}: {inside[key]}")


def kubernetes_follows_the_api():
    try:
        from kubernetes import client
    except ImportError:
        raise Skipped("python3-kubernetes is missing") from None
    for (kind, name), value in kubernetes().items():
        group, _, release = value["apiVersion"].rpartition("/")
        check(group in ("", "apps", "networking.k8s.io") and release == "v1", f"{kind}: apiVersion")
        as_model(client, f"V1{kind}", value, f"{kind} {name}")
    broken = kubernetes()["StatefulSet", "rips-policy-server"]
    for change in (lambda spec: spec.update(replica=1), lambda spec: spec.pop("selector"),
                   lambda spec: spec.update(replicas="1")):
        spec = dict(broken["spec"])
        change(spec)
        try:
            as_model(client, "V1StatefulSet", {**broken, "spec": spec}, "")
        except Failed:
            continue
        raise Failed("the models accept what the API refuses")


def as_model(client, kind, value, where):
    """Refuses keys that a model does not have, values of another type, and what is missing."""
    items = re.fullmatch(r"list\[(.*)\]|dict\(str, (.*)\)", kind)
    simple = {"str": str, "int": int, "bool": bool, "object": (str, int, dict),
              "datetime": datetime.datetime, "float": float}
    if items and items[1]:
        check(isinstance(value, list), f"{where} is no list")
        return [as_model(client, items[1], each, f"{where}[{index}]")
                for index, each in enumerate(value)]
    check(isinstance(value, dict) or kind in simple, f"{where} is no object")
    if items:
        return {key: as_model(client, items[2], each, f"{where}.{key}")
                for key, each in value.items()}
    if kind in simple:
        check(isinstance(value, simple[kind]), f"{where}: {value!r} is no {kind}")
        return value
    model = getattr(client, kind)
    names = {public: name for name, public in model.attribute_map.items()}
    unknown = set(value) - set(names)
    check(not unknown, f"{where}: {unknown} is not in {kind}")
    members = {names[key]: as_model(client, model.openapi_types[names[key]], each, f"{where}.{key}")
               for key, each in value.items()}
    try:
        return model(**members)
    except ValueError as why:
        raise Failed(f"{where}: {why}") from None


def kubernetes_is_one_confined_server():
    objects = kubernetes()
    spec = objects["StatefulSet", "rips-policy-server"]["spec"]
    check(spec["replicas"] == 1 and spec["updateStrategy"] == {"type": "RollingUpdate"}, "replicas")
    pod = spec["template"]["spec"]
    container, = pod["containers"]
    check(container["image"] == f"localhost/rips-policy-server:{version()}", container["image"])
    user = IDS["rips-policy-server"]
    check(pod["securityContext"] == {
        "runAsNonRoot": True, "runAsUser": user, "runAsGroup": user, "fsGroup": user,
        "fsGroupChangePolicy": "OnRootMismatch", "seccompProfile": {"type": "RuntimeDefault"}},
        f"the pod's securityContext is {pod['securityContext']}")
    check(container["securityContext"] == {
        "allowPrivilegeEscalation": False, "privileged": False, "readOnlyRootFilesystem": True,
        "runAsNonRoot": True, "capabilities": {"drop": ["ALL"]}},
        f"the container's securityContext is {container['securityContext']}")
    check(not {"hostNetwork", "hostPID", "hostIPC"} & set(pod), "the pod shares namespaces")
    limit = unit("rips-policy-server")["MemoryMax"]
    check(container["resources"]["limits"]["memory"] == f"{limit}i",
          "the memory limit is not that of the unit")
    ports = {port["name"] for port in container["ports"]}
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        get = container[probe]["httpGet"]
        check(get["port"] in ports and get["path"] in ("/healthz", "/readyz"), probe)
    grace = compose({})["services"]["policy-server"]["stop_grace_period"]
    check(f"{pod['terminationGracePeriodSeconds']}s" == grace, "grace periods differ")


def references_of_kubernetes_resolve():
    objects = kubernetes()
    stateful = objects["StatefulSet", "rips-policy-server"]["spec"]
    labels = stateful["template"]["metadata"]["labels"]
    check(stateful["selector"]["matchLabels"] == labels, "the StatefulSet selects other pods")
    check(("Service", stateful["serviceName"]) in objects, "serviceName names no Service")
    for (kind, name), value in objects.items():
        if kind == "Service":
            check(value["spec"]["selector"] == labels, f"Service {name} selects other pods")
        if kind == "NetworkPolicy":
            check(value["spec"]["podSelector"]["matchLabels"] == labels, f"{name}: other pods")
    pod = stateful["template"]["spec"]
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    claims = {claim["metadata"]["name"] for claim in stateful["volumeClaimTemplates"]}
    mounted = {mount["name"] for mount in pod["containers"][0]["volumeMounts"]}
    check(mounted == set(volumes) | claims, f"mounted are {mounted}")
    # What the file does not hold, its comment says how to create.
    text = (SOURCE / "deploy/kubernetes/policy-server.yaml").read_text(encoding="utf-8")
    for volume in volumes.values():
        named = {("ConfigMap", "configmap"): volume.get("configMap", {}).get("name"),
                 ("Secret", "secret generic"): volume.get("secret", {}).get("secretName")}
        for (kind, verb), name in named.items():
            check(not name or (kind, name) in objects or f"kubectl create {verb} {name} " in text,
                  f"{kind} {name} comes from nowhere")
    bundles = [mount for mount in pod["containers"][0]["volumeMounts"]
               if "/bundles/" in mount["mountPath"]]
    shipped = {path.name for path in (SOURCE / "rules/warehouse").iterdir()
               if not path.name.endswith("_test.yaml")}
    check({mount["subPath"] for mount in bundles} == shipped, "the bundle has other files")


STEPS = (compose_follows_its_schema, compose_confines_each_service,
         ports_are_those_of_the_configuration, kubernetes_follows_the_api,
         kubernetes_is_one_confined_server, references_of_kubernetes_resolve)


def main():
    failed = 0
    for step in STEPS:
        try:
            step()
            print(f"passed {step.__name__}")
        except Skipped as why:
            print(f"skipped {step.__name__}: {why}")
        except Failed as why:
            failed += 1
            print(f"FAILED {step.__name__}: {why}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
