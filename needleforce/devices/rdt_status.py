"""The status word in every record of a Net F/T, in words.

Bits as the manual of the sensor (Net F/T, system status code) and public drivers give
them.
"""

ERROR_SUMMARY = 1 << 31
"""Set with every error, and by some firmware with a latched threshold."""

THRESHOLD_LATCHED = 1 << 16
"""A threshold that the user has set was passed: the forces are valid."""

FAULT_BITS = 0xFFFE0000
"""Bits with which a record's forces are not used; those below come with bit 31."""

BIT_NAMES = {
    31: "error",
    30: "CPU or RAM error",
    29: "digital board error",
    28: "analog board error",
    27: "serial link error",
    26: "program memory error",
    25: "halted by its configuration",
    24: "settings invalid",
    23: "configuration does not fit the calibration",
    22: "network failure",
    21: "CAN error",
    20: "RDT error",
    19: "EtherNet/IP failure",
    18: "DeviceNet failure",
    17: "transducer saturated or converter error",
    16: "threshold latched",
    14: "watchdog timeout",
    13: "stack error",
    12: "EEPROM failure",
    11: "flash failure",
    10: "analog board watchdog timeout",
    9: "strain gauge current too high",
    8: "strain gauge current too low",
    7: "analog ground out of range",
    6: "analog supply too high",
    5: "analog supply too low",
    4: "serial link without data",
    3: "reference voltage or supply error",
    2: "temperature out of range",
    1: "HTTP failure",
}
"""What each bit of the status word means."""


def is_faulty(status: int) -> bool:
    """Return whether a record with this status word has no valid force."""
    is_latched_only = status == ERROR_SUMMARY | THRESHOLD_LATCHED
    return bool(status & FAULT_BITS) and not is_latched_only


def describe_status(status: int) -> str:
    """Return a status word in words, such as ``0x80020000: error, ...``."""
    if not status:
        return "0x00000000: well"

    names = [
        BIT_NAMES.get(bit, f"bit {bit}")
        for bit in reversed(range(32))
        if status >> bit & 1
    ]
    return f"0x{status:08x}: {', '.join(names)}"
