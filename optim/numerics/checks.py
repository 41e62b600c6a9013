"""Range checks of options, in one form for all who have options."""


def require(options: object, owner: str, **expected: tuple[str, bool]) -> None:
    """Raise ValueError for the first field out of range, as in `ddp: spacing is 0, expected more than 0 m`.

    Args:
        options: the object whose fields are checked.
        owner: the name that the message begins with.
        expected: by field, what its value must be, in words, and whether it is.
    """
    for field, (words, is_valid) in expected.items():
        if not is_valid:
            raise ValueError(f"{owner}: {field} is {getattr(options, field)!r}, expected {words}")
