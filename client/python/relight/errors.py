# SPDX-License-Identifier: MIT
"""The one exception of this package."""
from __future__ import annotations

from typing import Any, Optional


class RelightError(Exception):
    """A request that failed.

    code: the protocol's word ("NOT_FOUND", "OUT_OF_RANGE", "BUSY", ...), or of this client
    "UNREACHABLE", "DISCONNECTED", "TIMEOUT", "PROTOCOL" and "ARGUMENT".
    hint: what to do; may be empty. retry_after: seconds to wait where code is BUSY, else None.
    parameter, minimum, maximum, unit: of OUT_OF_RANGE, where one number is the fault.
    """

    def __init__(self, code: str, text: str, hint: str = "", retry_after: Optional[float] = None) -> None:
        super().__init__(text + ("; " + hint if hint else ""))
        self.code, self.text, self.hint, self.retry_after = code, text, hint, retry_after
        self.parameter = ""
        self.minimum: Optional[float] = None
        self.maximum: Optional[float] = None
        self.unit = ""

    @classmethod
    def of_message(cls, message: Any) -> "RelightError":
        names = message.DESCRIPTOR.fields_by_name["code"].enum_type.values_by_number
        name = names[message.code].name if message.code in names else "ERROR_INTERNAL"
        wait = message.retry_after_ms / 1000 if message.retry_after_ms else None
        error = cls(name.removeprefix("ERROR_"), message.text, message.hint, wait)
        error.parameter, error.unit = message.parameter, message.unit
        if message.has_range:
            error.minimum, error.maximum = message.minimum, message.maximum
        return error
