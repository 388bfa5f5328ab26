"""Numbers that stand in arrays for what is not there: no partner, no time; values of the field `supported`; columns of a path."""

from math import inf

NO_PARTNER = -(2**62)  # last partner before the first contact of a drift; other partners are ids >= 0 and walls -1, -2, ...
NEVER = inf
PRESSED, CROWD = 1, 2  # values of the field `supported`: pressed onto something by forces; one of many that collapse
START, RADIUS = 0, 1  # columns of a straight path, behind its place (d) and velocity (d): when it is there, and the radius
