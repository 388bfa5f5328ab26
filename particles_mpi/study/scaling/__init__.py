"""How a scene scales over ranks: measures strong and weak scaling, and extrapolates to more ranks by a model.

measure            `study scaling`: seconds, phases and counts of a step on some of the ranks, while the others sleep
scale_scene        a scene with more particles at the same density
counted            `study scaling --counts`: work and messages on more ranks than there are, counted and not timed; which grow
performance_model  t(N, P): seconds of a step on more ranks than there are
report             curves and predictions, as tables and rows of CSV files
figure             the same as a picture
"""
