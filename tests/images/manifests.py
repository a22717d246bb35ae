"""Reads deploy/compose.yaml and deploy/kubernetes/policy-server.yaml, for tests: those that compare
the files with the rest of the project, and those that start what they describe.
"""

import pathlib
import re

import yaml

SOURCE = pathlib.Path(__file__).resolve().parents[2]
COMPOSE = SOURCE / "deploy/compose.yaml"
KUBERNETES = SOURCE / "deploy/kubernetes/policy-server.yaml"


def version():
    text = (SOURCE / "CMakeLists.txt").read_text(encoding="utf-8")
    return re.search(r"^project\(rips VERSION ([0-9.]+)", text, re.M)[1]


def compose(environment):
    """The compose file, with `${NAME:-DEFAULT}` and `$$` replaced as an engine does."""
    def value(match):
        if match[0] == "$$":
            return "$"
        return environment.get(match[1]) or match[2]
    text = COMPOSE.read_text(encoding="utf-8")
    return yaml.safe_load(re.sub(r"\$\$|\$\{(\w+):-([^}]*)\}", value, text))


def kubernetes():
    """(KIND, NAME) -> object."""
    objects = list(yaml.safe_load_all(KUBERNETES.read_text(encoding="utf-8")))
    return {(each["kind"], each["metadata"]["name"]): each for each in objects}
