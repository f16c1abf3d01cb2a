"""What every message is: its common fields, and the types of numbers on the wire.

Data type: `Message`, a frozen msgspec struct with a tag of its kind. `protocol.messages` holds the kinds. Lengths in m, times in s, angles
in rad.
"""

from typing import Annotated

import msgspec

from protocol.fields import Name

WIRE_VERSION = 2
Tick = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Count = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
LagNumber = Annotated[int, msgspec.Meta(ge=0, le=64)]
PaceNumber = Annotated[int, msgspec.Meta(ge=1, le=64)]
TileNumber = Annotated[int, msgspec.Meta(ge=0, le=9_999_999)]
Vector = tuple[float, float]
Triple = tuple[float, float, float]
Setting = bool | int | float | str
Agreed = dict[str, dict[str, Setting]]  # section -> name -> value of the settings on which all agree (`agreement`)


class Message(msgspec.Struct, frozen=True, kw_only=True, dict=True, omit_defaults=True, tag_field="type"):
    """The fields of every message. A field that was not given is left out on the wire: it has its default."""

    sender: Name  # unique in the run, the last part of the key
    incarnation: Count  # grows with every restart under the same name
    wire: int = msgspec.field(default_factory=lambda: WIRE_VERSION)  # a factory, so that it is always said

    def check(self) -> None:
        """Raise `Malformed` unless every array and number is in range."""
