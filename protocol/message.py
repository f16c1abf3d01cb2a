"""What every message is: its common fields, and the types of numbers on the wire.

Data type: `Message`, a frozen msgspec struct with a tag of its kind. `protocol.messages` holds the kinds. Lengths in m, times in s, angles
in rad. A type of a number holds its limits, which also refuse NaN: it would win every comparison downstream.
"""

from typing import Annotated

import msgspec

from protocol.fields import LARGEST_AREA, LARGEST_NUMBER, LARGEST_SETTING, LARGEST_TIME, MAX_ROWS, Name

WIRE_VERSION = 2
Tick = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Natural = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]  # an incarnation, a hash
LagNumber = Annotated[int, msgspec.Meta(ge=0, le=64)]
PaceNumber = Annotated[int, msgspec.Meta(ge=1, le=64)]
TileNumber = Annotated[int, msgspec.Meta(ge=0, le=9_999_999)]
Number = Annotated[float, msgspec.Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]  # of either sign: a coordinate, an angle, a speed
Magnitude = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_NUMBER)]  # never negative, whatever its unit: a distance, a mass
Area = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_AREA)]
Time = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_TIME)]  # s, since the start of the world, or of a round
RowsOf8Bytes = Annotated[bytes, msgspec.Meta(max_length=8 * MAX_ROWS)]  # an array (`fields.Rows`) of at most `MAX_ROWS` rows of 8 bytes
RowsOf16Bytes = Annotated[bytes, msgspec.Meta(max_length=16 * MAX_ROWS)]
RowsOf24Bytes = Annotated[bytes, msgspec.Meta(max_length=24 * MAX_ROWS)]
Names = Annotated[tuple[str, ...], msgspec.Meta(max_length=MAX_ROWS)]  # any texts: one that is no `Name` is the name of no peer
Vector = tuple[Number, Number]
StatedPose = tuple[Number, Number, Number]  # a `sensing.Pose`: x m, y m, heading rad
Setting = bool | int | Annotated[float, msgspec.Meta(ge=-LARGEST_SETTING, le=LARGEST_SETTING)] | str
SharedSettings = dict[str, dict[str, Setting]]  # section -> name -> value of the settings on which all agree (`agreement`)


class Message(msgspec.Struct, frozen=True, kw_only=True, dict=True, omit_defaults=True, tag_field="type"):
    """The fields of every message. A field that was not given is left out on the wire: it has its default."""

    sender: Name  # unique in the run, the last part of the key
    incarnation: Natural  # grows with every restart under the same name
    wire: int = msgspec.field(default_factory=lambda: WIRE_VERSION)  # a factory, so that it is always said

    def check(self) -> None:
        """Raise `Malformed` unless every array is in range and all parts fit each other. The types hold the limits of single numbers."""
