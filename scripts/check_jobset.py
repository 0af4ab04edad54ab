"""Checks a JobSet that `djinn submit --engine kubernetes --dry-run` printed, without a cluster.

    pip install kubernetes-validate
    python scripts/check_jobset.py tests/golden/jobset.json [--crd FILE]

Each job is compared with Kubernetes' own schema, strictly: unknown keys are errors. FILE is the definition of JobSet
(config/components/crd/bases/jobset.x-k8s.io_jobsets.yaml of kubernetes-sigs/jobset, 0.8 or later), with whose schema the
whole is compared just as strictly. Schemas know nothing of what fields have to do with each other: those rules of
Kubernetes and of JobSet that the documents of the fields state, and on which the jobs rely, are checked here one by one.
"""

import argparse
import json
import re
import sys

import jsonschema
import kubernetes_validate
import yaml

LABEL = re.compile(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?")
POD_SUFFIX = "-abcde"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobset", help="the JobSet as JSON; - for the standard input")
    parser.add_argument("--crd", help="the definition of JobSet")
    parser.add_argument("--kubernetes", default="1.34", help="the version of Kubernetes [default: %(default)s]")
    args = parser.parse_args()
    with sys.stdin if args.jobset == "-" else open(args.jobset, encoding="utf-8") as file:
        jobset = json.load(file)
    problems = list(against_kubernetes(jobset, args.kubernetes))
    if args.crd:
        with open(args.crd, encoding="utf-8") as file:
            problems += against_definition(jobset, yaml.safe_load(file))
    # The rules take for granted that there are the fields of which they speak.
    problems = problems or list(against_rules(jobset))
    for problem in problems:
        print(problem, file=sys.stderr)
    n_jobs = len(jobset["spec"]["replicatedJobs"])
    whole = "the definition of JobSet" if args.crd else "no definition of JobSet (--crd)"
    print(f"{n_jobs} jobs compared with Kubernetes {args.kubernetes}, its rules and {whole}: {len(problems)} problems")
    sys.exit(1 if problems else 0)


def against_kubernetes(jobset, version):
    """Each job by itself, as the controller of JobSets makes it."""
    for job in jobset["spec"]["replicatedJobs"]:
        name = f"{jobset['metadata']['name']}-{job['name']}-0"
        made = {"apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": name}, **job["template"]}
        try:
            kubernetes_validate.validate(made, version, strict=True)
        except kubernetes_validate.ValidationError as error:
            yield f"{job['name']}: {'.'.join(map(str, error.path))}: {error.message}"


def against_definition(jobset, definition):
    """The whole with the schema that the cluster would use."""
    group, _, version = jobset["apiVersion"].partition("/")
    assert definition["spec"]["group"] == group, "the definition is of something else"
    [schema] = [v["schema"]["openAPIV3Schema"] for v in definition["spec"]["versions"] if v["name"] == version]
    schema["properties"]["metadata"] = {"type": "object", "x-kubernetes-preserve-unknown-fields": True}
    validator = jsonschema.Draft202012Validator(strict(schema))
    return [f"{'.'.join(map(str, error.path))}: {error.message}" for error in validator.iter_errors(jobset)]


def strict(schema):
    """The schema, which refuses keys that it does not know."""
    if isinstance(schema, list):
        return [strict(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {key: strict(value) for key, value in schema.items()}
    is_open = schema.get("x-kubernetes-preserve-unknown-fields") or "additionalProperties" in schema
    if isinstance(schema.get("properties"), dict) and schema.get("type") == "object" and not is_open:
        schema["additionalProperties"] = False
    if schema.get("x-kubernetes-int-or-string"):
        return {"type": ["integer", "string"]}
    return schema


def against_rules(jobset):
    """What fields have to do with each other."""
    name = jobset["metadata"]["name"]
    earlier = set()
    for job in jobset["spec"]["replicatedJobs"]:
        spec = job["template"]["spec"]
        pod = spec["template"]["spec"]
        waits_for = [one["name"] for one in job.get("dependsOn", [])]
        longest = f"{name}-{job['name']}-0-{spec['completions'] - 1}{POD_SUFFIX}"
        codes = [rule["onExitCodes"] for rule in spec["podFailurePolicy"]["rules"] if "onExitCodes" in rule]
        mounted = {mount["name"] for container in pod["containers"] for mount in container["volumeMounts"]}
        rules = {
            "waits for jobs before it, one at most": len(waits_for) <= 1 and earlier.issuperset(waits_for),
            "names of pods are labels of DNS": len(longest) <= 63 and LABEL.fullmatch(longest),
            "only the first job begins at once": bool(waits_for) == bool(earlier),
            "a policy of failures wants pods that are never restarted": pod["restartPolicy"] == "Never",
            "limits by index and policies of success want indexed jobs": spec["completionMode"] == "Indexed",
            "one kind of limit": ("backoffLimit" in spec) != ("backoffLimitPerIndex" in spec),
            "not more pods at once than indexes": 1 <= spec["parallelism"] <= spec["completions"] <= 100_000,
            "exit codes in order, none twice, none 0": all(
                code["values"] == sorted(set(code["values"])) and 0 not in code["values"] for code in codes
            ),
            "operators and actions that Kubernetes knows": all(code["operator"] in ("In", "NotIn") for code in codes)
            and all(rule["action"] in ("FailJob", "FailIndex", "Ignore", "Count") for rule in spec["podFailurePolicy"]["rules"]),
            "volumes are mounted, and mounts have volumes": mounted == {volume["name"] for volume in pod["volumes"]},
        }
        yield from (f"{job['name']}: {rule}: not so" for rule, holds in rules.items() if not holds)
        earlier.add(job["name"])


if __name__ == "__main__":
    main()
