"""Studies of the program itself: what accuracy costs, which setting a scene needs, how it scales, and hard cases.

`particles-mpi study`, in the order in which to read it:

commands     the commands of a user, and their arguments
timing       fair times of a step: settings in turn, on the slowest rank, medians with quartiles
experiment   the settings of a problem, the errors that each makes, and what each costs
report       tables, the page, CSV and JSON files; plots: the pictures
accuracy/    `study accuracy`: built-in problems with known solutions, and the settings of any scene
recommend/   `study recommend`: the cheapest setting of a scene that reaches a tolerance; the predictions of `check`
scaling/     `study scaling`: strong and weak scaling over ranks, and a model of more ranks
hard_cases/  `study hard-cases`: cases in which naive programs fail, and what must hold here
course.md    six exercises that lead from a serial loop to all of this
"""
