"""The one form in which a bad argument, setting or file is told.

Every message reads "`argument` must requirement, but got value where. remedy".
"""


def message(
    argument: str, requirement: str, value: object, where: str = "", remedy: str = ""
) -> str:
    """Compose the one form in which a bad argument is told.

    Args:
        argument: Name of the argument, the column or the key at fault.
        requirement: What it must do or be.
        value: What was found.
        where: Place with its preposition ("in a.json"), "" where there is none.
        remedy: One sentence that says what to do.

    Returns:
        The message.
    """
    place = f" {where}" if where else ""
    advice = f" {remedy}" if remedy else ""
    return f"`{argument}` must {requirement}, but got {value}{place}.{advice}"


def require(
    condition: bool,
    argument: str,
    requirement: str,
    value: object,
    where: str = "",
    remedy: str = "",
    error: type[ValueError] = ValueError,
) -> None:
    """Refuse a value; the arguments in the middle are those of `message`.

    Raises:
        ValueError: `condition` is false; of class `error`.
    """
    if not condition:
        raise error(message(argument, requirement, value, where, remedy))
