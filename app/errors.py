"""The error tree. It knows no HTTP: `app/api/errors.py` maps each class to a status code."""


class RoomfixError(Exception):
    """Base of every error that a caller can act on. `code` is stable, the message says what to change."""

    code = "error"


class InvalidInputError(RoomfixError):
    """A value that a caller gave can't be used."""

    code = "invalid_input"


class InvalidCameraError(InvalidInputError):
    """Intrinsics that no real camera has, or that can't belong to the image."""

    code = "invalid_camera"


class InvalidPoseError(InvalidInputError):
    """A pose with numbers that are not finite, or a rotation too far from SO(3)."""

    code = "invalid_pose"


class InvalidImageError(InvalidInputError):
    """Bytes that are not an image that can be read."""

    code = "invalid_image"


class UnsupportedImageError(InvalidImageError):
    """An image in a format that is not accepted."""

    code = "unsupported_image"


class ImageTooLargeError(InvalidImageError):
    """An image of more pixels or bytes than the limit."""

    code = "image_too_large"


class InvalidScanError(InvalidInputError):
    """A scan archive that can't become a map; the message says which file or frame and why."""

    code = "invalid_scan"


class UploadTooLargeError(InvalidInputError):
    """More bytes than the limit for an upload."""

    code = "upload_too_large"


class UnsupportedMediaError(InvalidInputError):
    """A body of another media type than the call takes."""

    code = "unsupported_media_type"


class OffNetworkError(InvalidInputError):
    """A point too far from everything that can be walked."""

    code = "off_network"


class DegenerateGeometryError(RoomfixError):
    """A geometric problem with too few or badly placed points to have one answer."""

    code = "degenerate_geometry"


class NotFoundError(RoomfixError):
    """A venue, floor, map or build that does not exist."""

    code = "not_found"


class NoVenueError(NotFoundError):
    """A position that no venue is near."""

    code = "no_venue"


class NotLocatedError(NotFoundError):
    """A picture that can't be placed, in a protocol that has no other word for it; the message has the reason."""

    code = "not_located"


class NoRouteError(NotFoundError):
    """Two places that no way joins, or none that the caller may take; the message says which parts are apart."""

    code = "no_route"


class ConflictError(RoomfixError):
    """A request that the present state doesn't allow."""

    code = "conflict"


class UploadLockedError(ConflictError):
    """Another part of an upload is being written."""

    code = "upload_locked"


class UnknownProtocolError(RoomfixError):
    """A version of a protocol that is not spoken here."""

    code = "unknown_protocol"


class AmbiguousVenueError(ConflictError):
    """A position that several venues are near."""

    code = "ambiguous_venue"


class BusyError(RoomfixError):
    """All workers are occupied and the queue is full; try again later."""

    code = "busy"


class DatabaseBusyError(BusyError):
    """Another program holds the lock of the database; try again later."""

    code = "database_busy"


class MapDamagedError(RoomfixError):
    """The file of a map, or of its index, is missing or is not what was stored; another version may still serve."""

    code = "map_damaged"


class StorageError(RoomfixError):
    """The disk or the database can't be written or read; an operator has to act."""

    code = "storage_failed"


class StorageFullError(StorageError):
    """No space is left on the disk; nothing was stored."""

    code = "storage_full"


class DatabaseDamagedError(StorageError):
    """The file of the database is not what was stored."""

    code = "database_damaged"


class CancelledBuildError(RoomfixError):
    """The build was cancelled while it ran."""

    code = "cancelled"


class AuthenticationError(RoomfixError):
    """No key, or one that is not known."""

    code = "unauthenticated"


class ExpiredKeyError(AuthenticationError):
    """The key was right until it expired."""

    code = "key_expired"


class RevokedKeyError(AuthenticationError):
    """The key was right until it was revoked."""

    code = "key_revoked"


class PermissionDeniedError(RoomfixError):
    """The key is known but lacks the scope, or is limited to another venue or camera."""

    code = "forbidden"


class ForeignCallerError(PermissionDeniedError):
    """A call to an open server that comes from another machine's web page, or names another host."""

    code = "foreign_caller"


class RateLimitError(RoomfixError):
    """Too many calls, or too many wrong keys; `retry_after_s` is when the next one is taken."""

    code = "too_many_requests"

    def __init__(self, message: str, retry_after_s: int) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s
