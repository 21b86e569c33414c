"""Keeps what long work says of itself."""

from contextlib import nullcontext


class Heard:
    """Listens in place of bars on a terminal."""

    def __init__(self):
        self.titles = []

    def waiting(self, title):
        self.titles.append(title)
        return nullcontext()

    def counted(self, items, title, unit, total):
        for number, item in enumerate(items, 1):
            yield item
            self.titles.append(f"{title}: {unit} {number}")
