"""What accuracy costs in time: built-in problems with known solutions, each in a file, and the settings of any scene.

command         `study accuracy`: which experiments there are; measures, prints and writes them
orbits          A and B: regular orbits and close encounters, by each integrator
fluid           C: the hard-sphere fluid, by collision mode, step and number of passes
tree            D: forces of a tree, by opening angle and multipole
softening       F: what softening changes and what it spares
losses          G: drag, friction, bounces
bouncing        the exact paths of bouncing balls, for G
effects         H: what each effect costs, and that an absent one costs nothing
resting         I: contacts that last, by the tolerance of their solution
rough           J: a ball that slides and rolls, by the step; how far a bed of rough spheres creeps on a slope
scene_accuracy  the settings and the effects of a scene of the user's
"""
