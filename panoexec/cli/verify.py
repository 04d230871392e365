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

from panoexec.cli.output import note, print_facts, print_json
from panoexec.cli.plan import certificate_facts, check_targets
from panoexec.cli.plan_map import check_plot_path, plot_plan
from panoexec.cli.planning_options import add_camera_arguments, add_constraint_arguments, constraints_of, profile_of
from panoexec.errors import UsageError
from panoexec.inputs.plan_file import camera_to_data, certificate_to_data, read_plan_file, write_plan
from panoexec.planning.baselines.published import PUBLISHED, published_plan
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
            | {"certificate": certificate_to_data(certificate)}
        )
    else:
        print_facts([("plan", f"{args.plan}: {len(plan.shots)} images of {plan.camera.name}")])
        print_facts(certificate_facts(certificate))
    return 0 if certificate.certified else 1


def _plan(args: argparse.Namespace) -> Plan:
    """The plan with the camera and constraints from the options."""
    camera = profile_of(args).camera if args.camera else None
    if str(args.plan) in PUBLISHED and not args.plan.exists():
        published = published_plan(str(args.plan))
        return replace(
            published, camera=camera or published.camera, constraints=constraints_of(args, published.constraints)
        )
    if not args.plan.suffix and not args.plan.exists():
        raise UsageError(f"{args.plan}: neither a file nor a published plan (published: {', '.join(PUBLISHED)})")
    file = read_plan_file(args.plan)
    return file.plan(camera=camera, constraints=constraints_of(args, file.constraints))
