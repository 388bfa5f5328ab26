"""The length of a step that ends with a contact."""

LENGTH_TOLERANCE = 1e-14  # of the whole step: how well the length must be known
SECANTS = 8  # tries after which the interval is halved
MOST_ROOT_TRIES = 64
PAST_JUMP = 0.01  # of the whole step: the least by which one goes on, without a contact, to the jump


class LengthSearch:
    """The length h, a time, of the step that ends with its first contact, where forces make the moment of that depend on h.

    A try is a step that is kicked as one of length h and moves on until the contact, or for `whole` if there is none. Let f(h) be
    the time of the contact minus h: it is below 0 in the whole step and above 0 in a very short one. In between is a zero,
    found by secants, which converge in about five tries, or by halving where they do not. It may be a jump instead, where a
    contact begins to last: no step ends with a contact then, and the longest that ends before it is taken. If that is shorter
    than `PAST_JUMP`, it is the one that was nearest to its contact, so that time goes on.

    h: the length to try next, or, if `jump`, to go on by without a contact.
    """

    def __init__(self, whole: float):
        self.h = self.whole = self.above = whole
        self.below = 0.0
        self.tries: list[tuple[float, float]] = []  # (length, how late the contact came)
        self.best = whole, whole  # the same for the try that was nearest to its contact
        self.last = self.jump = False

    def ends_with(self, late: float, met: bool) -> bool:
        """Was the step of length `h` the one? If not, `h` is new.

        late: how long after its end the contact is; met: whether there was one, or `whole` went by without.
        """
        if self.last or (met and abs(late) <= LENGTH_TOLERANCE * self.whole):
            return True
        self.tries.append((self.h, late))
        if met and abs(late) <= abs(self.best[1]):
            self.best = self.tries[-1]
        if late > 0.0:
            self.below = self.h
        else:
            self.above = self.h
        self.last = self.above - self.below <= LENGTH_TOLERANCE * self.whole or len(self.tries) == MOST_ROOT_TRIES
        self.jump = self.last and self.below >= PAST_JUMP * self.whole
        if self.jump:
            self.h = self.below
        elif self.last:
            self.h = self.best[0]
        else:
            self.h = self.guess()
        return False

    def guess(self) -> float:
        """Return the length by the secant through the last two tries, or halfway between lengths too short and too long."""
        (h, late), count = self.tries[-1], len(self.tries)
        guess = h + 0.5 * late
        if count > 1 and late != self.tries[-2][1]:
            guess = h - late * (h - self.tries[-2][0]) / (late - self.tries[-2][1])
        return guess if count <= SECANTS and self.below <= guess < self.above else 0.5 * (self.below + self.above)
