"""A drive on CAN that can be sent set points: the keys that say so."""

from typing import Annotated

from pydantic import Field

from onboard.devices.base import JointDevice


class DrivenDevice(JointDevice):
    """It measures a joint and, where ``driven``, moves it as ``[drive]`` says."""

    driven: Annotated[
        bool, Field(description="It plays the motion of `[drive]`; `NAME_status` and `NAME_sent` are recorded.")
    ] = False
    brake: Annotated[
        bool, Field(description="It has a brake, which stops it in a fault; else its motor slows it down.")
    ] = True
    check_units: Annotated[
        bool, Field(description="Refuse to drive it unless 608Fh, 6091h or 6092h say `counts_per_revolution` too.")
    ] = True
