"""Chooses how many steps the candidates of a search hold: hill climbing on counted work, the same on every rank."""

MOST_STEPS = 400
STRIDE = 0.15  # of the steps, from one try to the next
WORSE = 1.003  # times the cost before: above it the cost has risen
# Costs of a search, a row in it, a row that searches alone, a pair in a step; in the time of one pair test (about 5 ns).
SEARCH_COST, ROW_COST, SEEKER_COST, PAIR_COST = 2e4, 50.0, 100.0, 1.0


class RebuildTuner:
    """`steps`: for how many the next candidates hold. If that is more, there are fewer searches, but more candidates in each."""

    def __init__(self) -> None:
        self.steps = 0
        self.upwards = True
        self.cost_before = float("inf")
        self.lasted = 0  # steps since the last search
        self.early = 0  # searches in a row that ended before their time
        self.pair_steps = 0

    def step(self, pairs: int) -> None:
        """Count one more step, with so many pairs."""
        self.lasted += 1
        self.pair_steps += pairs

    def work(self, rows: int, tests: int, seekers: int) -> float:
        """Return what the candidates have cost this rank since their search; `seekers`: rows that looked for partners alone."""
        return SEARCH_COST + ROW_COST * rows + tests + SEEKER_COST * seekers + PAIR_COST * self.pair_steps

    def next(self, work: float, crossing: float) -> int:
        """Return for how many steps the next candidates hold; `work`: that of all ranks since the last search.

        `crossing`: steps in which the fastest row covers half of the mean distance of rows; the search for the best begins there.
        """
        if self.steps == 0:
            self.steps = int(min(crossing, MOST_STEPS))
        elif self.lasted:
            stride = max(1, round(STRIDE * self.steps))
            if self.lasted < self.steps:  # it ended early, as where a row got too far: its cost says nothing of the best interval
                self.early += 1
                self.steps = max(self.steps - self.early * stride, self.lasted)
            else:
                self.early = 0
                cost = work / self.lasted
                if cost > WORSE * self.cost_before:
                    self.upwards = not self.upwards
                self.cost_before = cost
                self.steps += stride if self.upwards else -stride
        self.steps = min(max(self.steps, 1), MOST_STEPS)
        self.upwards = self.steps == 1 or (self.upwards and self.steps < MOST_STEPS)  # from either end only back
        self.lasted = self.pair_steps = 0
        return self.steps
