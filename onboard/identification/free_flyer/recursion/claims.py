"""What a detected or announced change of the payload was, by the hypothesis that explains the window after it.

An announcement is a claim that the motion can contradict: a release, if the payload held before explains the next
window and nothing held does not; a capture, if nothing held explains the window and it determines no payload.
"""

from onboard.estimation.arrays import FloatArray
from onboard.identification.change import Change
from onboard.identification.free_flyer.recursion.solved import HeldPayload

_KINDS = {  # of a detected change, by what was held before and what explains the window after it
    (True, HeldPayload.NOTHING): "ejection",
    (True, HeldPayload.SAME): "contact",
    (True, HeldPayload.NEW): "instrument",
    (False, HeldPayload.NOTHING): "contact",
    (False, HeldPayload.NEW): "capture",
}


def kind_of(before: bool, hypothesis: HeldPayload, instrument: bool = False, *, altered: bool = False) -> str:
    """What a detected change was.

    Args:
        before: a payload was held.
        hypothesis: explains the window after it.
        instrument: an instrument was found to be wrong, and is left out of that window.
        altered: it explains it with a payload of which a part has come off or been added, if one was held.
    """
    if altered and (before or hypothesis is HeldPayload.SAME):
        return "altered"
    return "instrument" if instrument and hypothesis is not HeldPayload.NEW else _KINDS[before, hypothesis]


def after_a_change(held: bool, known: bool = True) -> tuple[HeldPayload, ...]:
    """Hypotheses in the order in which they are tried; ``known``: there is an estimate of what was held."""
    same = (HeldPayload.SAME,) if held and known else ()
    return (HeldPayload.NOTHING, *same, HeldPayload.NEW)


def at_first(held: bool, carried: bool) -> tuple[HeldPayload, ...]:
    """Hypotheses of the first window; ``carried``: what was held last is known, and ``held`` does not count."""
    if carried:
        return HeldPayload.SAME, HeldPayload.NOTHING, HeldPayload.NEW
    return (HeldPayload.NEW if held else HeldPayload.NOTHING,)


class Claim:
    """The last announcement, until it is settled.

    Attributes:
        held: what was announced; None if nothing waits to be settled.
        unseen: the joints were not known for a while before or in the window, so a change may not have been seen.
    """

    def __init__(self) -> None:
        self.held: bool | None = None
        self.unseen = False

    def make(self, held: bool, known: bool) -> tuple[HeldPayload, ...]:
        """The hypotheses to be tried after an announcement; ``known``: there is an estimate of what was held."""
        self.held = held
        if held:
            return (HeldPayload.NEW,)
        return (HeldPayload.NOTHING, HeldPayload.SAME) if known else (HeldPayload.NOTHING,)

    def otherwise(
        self, tried: tuple[HeldPayload, ...], window_s: FloatArray
    ) -> tuple[tuple[HeldPayload, ...], Change | None]:
        """The hypotheses of the window after one that those tried do not explain, and a change that was not seen.

        Args:
            tried: that it stays as it was, or that it changed.
            window_s: times of the window's ticks, (n,).
        """
        unseen, self.unseen = self.unseen, False
        if self.held:
            return (HeldPayload.NEW,), None
        if not unseen or tried not in ((HeldPayload.NOTHING,), (HeldPayload.SAME,)):
            return tried, None
        change = Change("change", float(window_s[-1]), float(window_s[0]), float("nan"))
        return after_a_change(tried == (HeldPayload.SAME,)), change

    def settle(self, hypothesis: HeldPayload, now_s: float) -> list[Change]:
        """What is to be said of the announcement when a hypothesis explains the window after it."""
        self.unseen = False
        if self.held is None or (self.held and hypothesis is HeldPayload.NEW):
            return []  # a capture may still be not determined
        rejected = []
        if self.held:
            rejected.append(Change("capture_contradicted", now_s, now_s, float("nan"), "nothing held moves alike"))
        elif hypothesis is HeldPayload.SAME:
            rejected.append(Change("release_contradicted", now_s, now_s, float("nan"), "the payload moves as before"))
        self.held = None
        return rejected
