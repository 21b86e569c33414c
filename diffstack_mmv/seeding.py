"""Random numbers that belong to what they are drawn for, and to no order of drawing."""


def stream(seed: int, number: int) -> int:
    """Seed of the generator of a number (of a sample, a step) below a million, for each seed apart.

    Generators of a CPU take 32 bits of it.
    """
    return (1_000_003 * seed + number) % 2**32
