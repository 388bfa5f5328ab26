"""Numbers that stand in arrays for what is not there: no partner, no time; and the values of the field `supported`."""

from math import inf

NOBODY = -(2**62)  # last partner before the first contact of a drift; other partners are ids >= 0 and walls -1, -2, ...
NEVER = inf
PRESSED, CROWD = 1, 2  # values of the field `supported`: pressed onto something by forces; one of many that collapse
