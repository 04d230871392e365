"""Judge a plan file, ours or not: does it cover the band whatever the pointing errors, and do its images overlap?

What the file does not say (a foreign file names poses only) is given by options; options also override the file.
Exit code 1: the plan is not certified.

Example:
  panoexec verify plan.json --tolerance-yaw 1.0
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from panoexec.cli.output import note, print_facts, print_json
from panoexec.cli.plan import certificate_facts
from panoexec.cli.planning_options import add_camera_arguments, add_constraint_arguments, constraints_of, profile_of
from panoexec.planfile import camera_to_data, certificate_to_data, read_plan_file
from panoexec.planning.certificate import certify
from panoexec.planning.request import check_request
from panoexec.plotting import check_plot_path, plot_plan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("plan", type=Path, metavar="PLAN.json")
    add_camera_arguments(parser, required=False)
    add_constraint_arguments(parser)
    output = parser.add_argument_group("output")
    output.add_argument("--plot", type=Path, metavar="FILE.png|.svg", help="draw the footprints and what fails")
    output.add_argument("--json", action="store_true", help="one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Certify and show the verdict."""
    if args.plot:
        check_plot_path(args.plot)
    file = read_plan_file(args.plan)
    plan = file.plan(
        camera=profile_of(args).camera if args.camera else None, constraints=constraints_of(args, file.constraints)
    )
    check_request(plan.camera, plan.constraints)
    certificate = certify(plan)
    if args.plot:
        plot_plan(replace(plan, certificate=certificate), args.plot)
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
