"""Frames that the build of a map version left out: how many, why, and pictures of some of them."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field

from app.api.deps import State, VenueId, require
from app.api.maps.versions import Version
from app.api.requests.conditional import NOT_MODIFIED, is_known, unless_known
from app.api.requests.contract_route import ContractRoute
from app.api.schemas import FILE_CONTENT, problems
from app.services.map_views.left_out import LeftOut, LeftOutGroup, left_out_of, left_out_picture_blob

router = APIRouter(
    prefix="/venues/{venue}/maps/{version}/left-out",
    tags=["maps"],
    route_class=ContractRoute,
    dependencies=[Depends(require("admin"))],
)


class LeftOutPictureBody(BaseModel):
    """A frame that was left out, of which a small picture is kept."""

    picture: int = Field(description="Its number in .../left-out/{picture}")
    name: str = Field(description="Its file in the scan")
    time_s: float | None = Field(description="Seconds since the scan's first frame, null where not known")


class LeftOutGroupBody(BaseModel):
    """The frames that were left out for one reason."""

    reason: str = Field(
        description="`blurred` and `badly_exposed`: it would have been a keyframe; `no_depth`, `no_pose`, "
        "`invalid_pose`, `missing_file`, `unreadable_file`: the scan's files; `unconnected`, `poor_image`, "
        "`other_size`: pictures without poses"
    )
    frames: int
    names: list[str] = Field(description="The first hundred of them")
    pictures: list[LeftOutPictureBody] = Field(description="Evenly chosen; none in a map without pictures")

    @staticmethod
    def of(group: LeftOutGroup) -> LeftOutGroupBody:
        """Return the body of a group."""
        pictures = [
            LeftOutPictureBody(picture=number, name=frame.name, time_s=frame.time_s)
            for number, frame in group.pictures
        ]
        return LeftOutGroupBody(
            reason=group.reason, frames=group.frames, names=group.names, pictures=pictures
        )


class LeftOutBody(BaseModel):
    """What the build of a map version left out of its scan."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "frames": 300,
                "left_out": 12,
                "replaced": 7,
                "groups": [
                    {
                        "reason": "blurred",
                        "frames": 12,
                        "names": ["rgb/1216.800000.jpg"],
                        "pictures": [{"picture": 0, "name": "rgb/1216.800000.jpg", "time_s": 16.8}],
                    }
                ],
            }
        }
    )

    frames: int | None = Field(description="Frames of the scan; null in a map of an older server")
    left_out: int
    replaced: int = Field(description="Those of them in whose place a frame beside it was taken")
    groups: list[LeftOutGroupBody] = Field(description="By reason, most frames first")

    @staticmethod
    def of(found: LeftOut) -> LeftOutBody:
        """Return the body of what was left out."""
        return LeftOutBody(
            frames=found.frames,
            left_out=sum(group.frames for group in found.groups),
            replaced=found.replaced,
            groups=[LeftOutGroupBody.of(group) for group in found.groups],
        )


@router.get("", name="getLeftOut", responses=problems(401, 404, 422))
def left_out(state: State, venue: VenueId, version: Version) -> LeftOutBody:
    """Return which frames of the scan the build left out, by reason, and of which there are pictures."""
    return LeftOutBody.of(left_out_of(state.services.resources, venue, version))


@router.get(
    "/{picture}",
    name="getLeftOutPicture",
    responses={200: {"content": {"image/jpeg": FILE_CONTENT}}, **NOT_MODIFIED, **problems(401, 404, 422)},
    response_class=Response,
)
async def picture(
    state: State,
    request: Request,
    venue: VenueId,
    version: Version,
    picture: Annotated[int, Path(ge=0, le=2**31 - 1, description="The picture's number")],
) -> Response:
    """Return the small picture of a frame that was left out, of a map that was built with store_images."""
    resources = state.services.resources
    blob = await run_in_threadpool(left_out_picture_blob, resources, venue, version, picture)
    if is_known(request, blob):
        return unless_known(request, blob, Response)
    data = await run_in_threadpool(resources.blobs.get, blob)
    return unless_known(request, blob, lambda: Response(data, media_type="image/jpeg"))
