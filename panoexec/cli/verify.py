"""Check a plan file from any planner: coverage for all pointing errors within tolerance, overlaps and connectivity.

Options supply what the file does not contain (a file from another planner may contain only poses) and override what it
contains. Instead of a file, give the name of a plan published in the paper: scenario-1-proposed, scenario-1-hdrpano,
scenario-2-proposed, scenario-2-hdrpano, scenario-3-proposed.
Exit code 1: the plan is not certified.

Example:
  panoexec verify plan.json --tolerance-yaw 1.0
  panoexec verify scenario-2-hdrpano --plot hole.png
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from panoexec.cli.output import counted, note, print_facts, print_json
from panoexec.cli.plan import certificate_facts, check_targets
from panoexec.cli.plan_map import check_plot_path, plot_plan
from panoexec.cli.planning_options import (
    add_camera_arguments,
    add_constraint_arguments,
    lens_in_words,
    profile_of,
    spec_of,
)
from panoexec.errors import UsageError
from panoexec.inputs.plan_file import PlanFile, camera_to_data, certificate_to_data, read_plan_file, write_plan
from panoexec.planning.baselines.published import PUBLISHED, published_plan
from panoexec.planning.cautions import cautions
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Plan
from panoexec.planning.request import check_request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("plan", type=Path, metavar="PLAN.json|NAME", help="plan file, or name of a published plan")
    add_camera_arguments(parser, required=False)
    add_constraint_arguments(parser, of_file=True)
    output = parser.add_argument_group("output")
    output.add_argument("--output", type=Path, metavar="PLAN.json", help="write the plan with its certificate")
    output.add_argument("--plot", type=Path, metavar="FILE.png|.svg", help="plot the image footprints and the failures")
    output.add_argument("--json", action="store_true", help="print one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Certify the plan and print the certificate."""
    check_targets([args.output, args.plot])
    if args.plot:
        check_plot_path(args.plot)
    plan = _plan(args)
    check_request(plan.camera, plan.constraints)
    certificate = certify(plan)
    judged = replace(plan, certificate=certificate)
    if args.output:
        write_plan(args.output, judged)
        note(f"wrote {args.output}")
    if args.plot:
        plot_plan(judged, args.plot)
        note(f"wrote {args.plot}")
    if args.json:
        print_json(
            {"plan": str(args.plan), "camera": camera_to_data(plan.camera)}
            | {"certificate": certificate_to_data(certificate), "notes": list(cautions(certificate))}
        )
    else:
        name = f"{args.plan}: {counted(len(plan.shots), 'image')} of {plan.camera.name}"
        print_facts([("plan", name), ("lens", lens_in_words(plan.camera))])
        print_facts(certificate_facts(certificate))
        for text in cautions(certificate):
            note(f"note: {text}")
    return 0 if certificate.certified else 1


def _plan(args: argparse.Namespace) -> Plan:
    """The plan named, with the camera and the constraints asked for."""
    profile = profile_of(args) if args.camera else None
    given = spec_of(args, profile=profile, file=_file(args.plan)).given
    assert given is not None
    return given


def _file(path: Path) -> PlanFile:
    name = str(path)
    if name in PUBLISHED and not path.exists():
        plan = published_plan(name)
        return PlanFile(
            source=name, method=plan.method, camera=plan.camera, constraints=plan.constraints, shots=plan.shots
        )
    if not path.suffix and not path.exists():
        raise UsageError(f"{path}: neither a file nor a published plan (published: {', '.join(PUBLISHED)})")
    return read_plan_file(path)
