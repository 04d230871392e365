"""The payload on the wire: a MAVLink gimbal (component 154) and a MAVLink camera (component 100) on one link.

It works with the embedded autopilot and with a real ArduPilot with `MNT1_TYPE` 6 alike.
"""

from __future__ import annotations

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.camera_beside import CameraBeside
from panoexec.sim.mavlink.camera_component import CameraComponent, Develop
from panoexec.sim.mavlink.gimbal_beside import SecondGimbal, Stranger
from panoexec.sim.mavlink.gimbal_component import GimbalComponent
from panoexec.sim.mavlink.released_camera import ReleasedCamera
from panoexec.sim.mavlink.wire import Link, Message
from panoexec.sim.physics.gimbal import GimbalPhysics
from panoexec.sim.physics.world import SimClock, Timeline


class Payload:
    """Gimbal and camera on one link.

    Attributes:
        gimbal: component 154.
        second: another gimbal; None if there is none.
        stranger: a component that tells wrong attitudes; None if there is none.
        camera: component 100, or 101 beside another one.
        beside: what is component 100 then; None if there is none.
        released: instead of that, a camera that an autopilot triggers by a contact; None if there is none.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        timeline: Timeline,
        physics: GimbalPhysics,
        faults: Faults,
        link: Link,
        develop: Develop,
        definition_uri: str = "",
    ) -> None:
        self.gimbal = GimbalComponent(config, timeline=timeline, physics=physics, faults=faults, link=link)
        self.second: SecondGimbal | None = None
        self.stranger: Stranger | None = None
        if config.gimbal_beside == "second":
            self.second = SecondGimbal(config, timeline=timeline, link=link)
        elif config.gimbal_beside == "stranger":
            self.stranger = Stranger(config, timeline=timeline, physics=physics, faults=faults, link=link)
        self.released: ReleasedCamera | None = None
        if config.camera_kind == "servo" and config.attach_url is not None:
            self.released = ReleasedCamera(config, timeline=timeline, physics=physics, faults=faults, develop=develop)
        self.camera = CameraComponent(
            config,
            clock=clock,
            timeline=timeline,
            gimbal=self.gimbal,
            faults=faults,
            link=link,
            develop=develop,
            definition_uri=definition_uri,
        )

        self.beside: CameraBeside | None = None
        if config.camera_beside != "none" and config.camera_kind == "mavlink":
            self.beside = CameraBeside(config, timeline=timeline, link=link)

    def start_gimbals(self) -> None:
        """Start the gimbal and what is beside it."""
        self.gimbal.start()
        if self.second is not None:
            self.second.start()
        if self.stranger is not None:
            self.stranger.start()

    def start(self) -> None:
        """Start heartbeats and streams."""
        self.start_gimbals()
        if self.released is None:
            self.start_camera()

    def start_camera(self) -> None:
        """Start the heartbeats of the camera, and of what is beside it, which boots sooner."""
        if self.beside is not None:
            self.beside.start()
        self.camera.start()

    def receive(self, message: Message, frame: bytes) -> None:
        """Handle a message from the link."""
        del frame
        self.gimbal.receive(message)
        if self.second is not None:
            self.second.receive(message)
        if self.beside is not None:
            self.beside.receive(message)
        if self.released is None:
            self.camera.receive(message)
        else:
            self.released.receive(message)
