"""The guards as they are configured: the same for the daemon, dry-runs and Python programs."""

from __future__ import annotations

from panoexec.inputs.vehicle_sections import GimbalSection, GuardsSection
from panoexec.mission.settings import GuardSettings


def guard_settings(guards: GuardsSection, gimbal: GimbalSection) -> GuardSettings:
    """The settings for the sections `[guards]` and `[gimbal]` of a configuration."""
    return GuardSettings(
        battery_floor_frac=guards.battery_floor_frac,
        hover_s=60 * guards.hover_min,
        position_drift_m=guards.position_drift_m,
        parallax_px=guards.parallax_px,
        allowed_modes=guards.allowed_modes,
        attitude_silence_s=guards.attitude_silence_s,
        position_hold=guards.require_in_air,
        reclaim="ask" if gimbal.when_taken == "reclaim" else "never",
    )
