"""A trained stack from Python: what was observed up to now goes in, forecast and plan come out."""

from diffstack_mmv.online.stack import Decision, OnlineStack

__all__ = ["Decision", "OnlineStack"]
