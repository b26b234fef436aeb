"""What can go wrong. Everything that this package raises on purpose is a ``RealitySimError``."""

from __future__ import annotations

import json

__all__ = ["Busy", "CaptureWarning", "NotFound", "ProgramError", "RealitySimError", "Refused", "ServiceError", "ServiceTimeout", "Unreachable"]


class RealitySimError(Exception):
    """Any failure of this package."""


class ServiceError(RealitySimError):
    """The service answered with an error; ``status`` is HTTP's, ``detail`` says what would be right."""

    def __init__(self, status: int, detail: str):
        super().__init__(f"{status}: {detail}")
        self.status = status
        self.detail = detail


class NotFound(ServiceError):
    """404: no image is near enough, or there is no such capture or frame."""


class Refused(ServiceError):
    """401 or 403: the token is missing or wrong."""


class Busy(ServiceError):
    """503: the service stayed busy for longer than ``patience_s``."""


class Unreachable(RealitySimError, ConnectionError):
    """Nobody answers at the address, or the connection broke."""


class ServiceTimeout(RealitySimError, TimeoutError):
    """The service did not answer within ``timeout_s``."""


class ProgramError(RealitySimError):
    """The program ``realitysim`` is missing, or ended with an error."""


class CaptureWarning(UserWarning):
    """A capture has lost something: it says what, and the rest can be used."""


def error_of(status: int, content: bytes) -> ServiceError:
    """The error of an answer, whose body is a problem document (RFC 9457)."""
    try:
        detail = str(json.loads(content)["detail"])
    except (ValueError, KeyError, TypeError):
        detail = content.decode("utf-8", "replace")
    kind = {404: NotFound, 401: Refused, 403: Refused, 503: Busy}.get(status, ServiceError)
    return kind(status, detail)
