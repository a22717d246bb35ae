#!/usr/bin/env python3
"""Checks what ripsctl prints as JSON against deploy/schema/ripsctl.

  ripsctl_json_test.py TEST_PROGRAM...

Runs the programs, which are tests of ripsctl, with RIPS_JSON_SAMPLES: they leave all JSON that they
see there (policy_server/ripsctl/offline_run.h). Each verb of testdata/help.txt needs a sample, each
schema a use. Exits with 1 for a sample that its schema does not take, or a schema that takes a
sample with one field more or one required field less; with 77 without python3-jsonschema.
"""

import copy
import json
import os
import pathlib
import subprocess
import sys
import tempfile

try:
    import jsonschema
except ImportError:
    sys.path.append("/usr/lib/python3/dist-packages")  # another Python than Debian's
    try:
        import jsonschema
    except ImportError:
        print("skipped: python3-jsonschema is not installed")
        sys.exit(77)

SOURCE = pathlib.Path(__file__).resolve().parents[2]
SCHEMAS = SOURCE / "deploy/schema/ripsctl"
HELP = SOURCE / "policy_server/ripsctl/testdata/help.txt"
# The schema of each verb; of a list, any of them.
OF_VERB = {
    "robot list": "robot_list", "robot watch": "robot_status", "robot show": "robot_status",
    "robot config": "robot_config", "robot graph": "robot_graph", "robot interest": "robot_interest",
    "robot coverage": "robot_coverage", "robot receipts": "robot_receipts",
    "robot drill": "robot_drill", "robot maintenance": "robot_maintenance",
    "level show": "level_show", "level history": "level_history", "level raise": "level_change",
    "level lower": "level_change", "level approve": "level_approve",
    "alert list": "alert_list", "alert watch": "alert", "alert ack": "alert_ack",
    "alert recording": "alert_recording",
    "explain": "explain",
    "rules check": "rules_check", "rules fmt": "rules_fmt", "rules builtins": "rules_builtins",
    "rules test": "rules_test", "rules replay": ["rules_replay", "rules_check"],
    "rules sign": ["rules_sign", "rules_check"], "rules push": "rules_push",
    "rules list": "rules_list", "rules activate": "rules_activate",
    "rules rollback": "rules_activate", "rules stop": "rules_stop", "rules status": "rules_status",
    "rules shadow": "rules_shadow", "rules resume": "rules_resume",
    "audit verify": "audit_log", "audit tail": "audit_tail", "audit export": "audit_record",
    "agent list": "agent_list", "agent ban": "agent_ban", "agent unban": "agent_ban",
    "agent reset-term": "agent_reset_term",
    "enrol create-token": "enrol_create_token", "enrol revoke-token": "enrol_revoke_token",
    "enrol list": "enrol_list",
    "signal send": "signal_send",
    "record": "record",
    "context list": "context_list", "context use": "context_use",
}
# Verbs that print no JSON.
WITHOUT_JSON = {"completion bash", "top"}
# Fields that may be missing and that no test prints: of lists of a million entries, and of an alert
# that is part of a list.
UNSEEN = {"alert": {"acknowledged"}, "rules_replay": {"left_out"}}


class Schemas:
    """Each file, with the files that it refers to in their places."""

    def __init__(self):
        self.raw = {path.name: json.loads(path.read_text())
                    for path in sorted(SCHEMAS.glob("*.schema.json"))}
        self.used = set()
        self.validators = {}

    def of(self, name):
        if name not in self.validators:
            whole = self.resolved(f"{name}.schema.json")
            jsonschema.Draft202012Validator.check_schema(whole)
            self.validators[name] = jsonschema.Draft202012Validator(whole)
        return self.validators[name]

    def resolved(self, file):
        self.used.add(file)
        if file not in self.raw:
            sys.exit(f"there is no {SCHEMAS.relative_to(SOURCE)}/{file}")
        return self.inlined({key: value for key, value in self.raw[file].items()
                             if key not in ("$id", "title", "description")})

    def inlined(self, node):
        if isinstance(node, list):
            return [self.inlined(each) for each in node]
        if not isinstance(node, dict):
            return node
        if "$ref" in node:
            return self.resolved(node["$ref"])
        return {key: self.inlined(value) for key, value in node.items()}


def verbs():
    """Of help.txt: those that have no verbs below them."""
    named = [line[len("$ ripsctl "):-len(" --help")] for line in HELP.read_text().splitlines()
             if line.startswith("$ ripsctl ") and line.endswith(" --help")]
    return {each for each in named
            if each and not any(other.startswith(each + " ") for other in named)}


def verb_of(args, known):
    words = [each for i, each in enumerate(args)
             if not each.startswith("-") and (i == 0 or args[i - 1] != "--output")]
    two = " ".join(words[:2])
    return two if two in known else words[0]


def samples(programs, known):
    """(verb, object) of all that the programs saw."""
    found = []
    with tempfile.TemporaryDirectory() as directory:
        environment = dict(os.environ, RIPS_JSON_SAMPLES=directory)
        for program in programs:
            done = subprocess.run([program], env=environment, stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, check=False)
            if done.returncode != 0:
                sys.stdout.write(done.stdout.decode(errors="replace")[-4000:])
                sys.exit(f"{program} failed")
        for path in sorted(pathlib.Path(directory).iterdir()):
            head, *lines = path.read_text().splitlines()
            verb = verb_of(json.loads(head)["args"], known)
            for line in lines:
                try:
                    found.append((verb, json.loads(line)))
                except ValueError:
                    found.append((verb, f"not JSON: {line[:200]}"))
    return found


def nodes(value):
    """All objects in it that have fields."""
    if isinstance(value, dict):
        yield value
        value = list(value.values())
    if isinstance(value, list):
        for each in value:
            yield from nodes(each)


def spoiled(sample):
    """(what was done, copy): a field more in each object, and each field of the outermost less."""
    for i in range(len(list(nodes(sample)))):
        worse = copy.deepcopy(sample)
        list(nodes(worse))[i]["not_in_any_schema"] = [1]
        yield "one field more", worse
    if isinstance(sample, dict):
        for name in sample:
            yield f"without `{name}`", {key: sample[key] for key in sample if key != name}


def optional(validator):
    schema = validator.schema
    return set(schema.get("properties", {})) - set(schema.get("required", []))


def check_sample(schemas, verb, sample, problems):
    """The name of the schema that takes it."""
    names = OF_VERB[verb] if isinstance(OF_VERB[verb], list) else [OF_VERB[verb]]
    for name in names:
        if schemas.of(name).is_valid(sample):
            return name
    errors = [jsonschema.exceptions.best_match(schemas.of(name).iter_errors(sample))
              for name in names]
    for name, error in zip(names, errors):
        place = "/".join(str(each) for each in error.absolute_path)
        problems.append(f"{verb}: not as {name}.schema.json says, at `{place}`: "
                        f"{error.message[:300]}")
    return None


def check_spoiled(schemas, verb, name, sample, problems):
    validator = schemas.of(name)
    # A field that may be left out may be missing, and one that is there in another schema only.
    free = {f"without `{each}`" for each in optional(validator)}
    for what, worse in spoiled(sample):
        if what in free or not validator.is_valid(worse):
            continue
        # Values of a map by free names, such as `variables`, may be more.
        problems.append(f"{verb}: {name}.schema.json takes it {what}: {json.dumps(worse)[:300]}")


def main(programs):
    known = verbs()
    problems = [f"`{each}` has no schema in {pathlib.Path(__file__).name}"
                for each in sorted(known - set(OF_VERB) - WITHOUT_JSON)]
    problems += [f"`{each}` is no verb of ripsctl" for each in sorted(set(OF_VERB) - known)]
    schemas = Schemas()
    seen = {}
    spoilt = {}
    fields_seen = {}
    for verb, sample in samples(programs, known):
        if verb not in OF_VERB:
            if verb not in known:
                problems.append(f"a sample of no verb: {verb}")
            continue  # else said above
        seen[verb] = seen.get(verb, 0) + 1
        if isinstance(sample, dict):
            fields_seen.setdefault(verb, set()).update(sample)
        name = check_sample(schemas, verb, sample, problems)
        # Of each verb and set of fields a few are enough.
        fields = (verb, tuple(sample) if isinstance(sample, dict) else ())
        if name is not None and spoilt.setdefault(fields, 0) < 3:
            spoilt[fields] += 1
            check_spoiled(schemas, verb, name, sample, problems)
    problems += [f"no test prints JSON of `{each}`" for each in sorted(set(OF_VERB) - set(seen))]
    for name in {one for of in OF_VERB.values() for one in (of if isinstance(of, list) else [of])}:
        printed = set().union(*(fields for verb, fields in fields_seen.items()
                                if name in OF_VERB[verb]))
        problems += [f"no test prints `{each}` of {name}.schema.json"
                     for each in sorted(optional(schemas.of(name)) - printed
                                        - UNSEEN.get(name, set()))]
    problems += [f"no verb uses {each}" for each in sorted(set(schemas.raw) - schemas.used)]
    for each in dict.fromkeys(problems):
        print(each)
    print(f"{sum(seen.values())} samples of {len(seen)} verbs, {len(schemas.raw)} schemas, "
          f"{len(dict.fromkeys(problems))} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
