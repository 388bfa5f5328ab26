"""The program measures itself: what accuracy costs, what a scene needs, how it scales, and what stays right in hard cases.

`particles-mpi study`, in the order in which to read it:

commands     what a user can ask for, with its arguments
timing       fair seconds of a step: by turns, the slowest rank, medians with quartiles
experiment   settings of a problem, the errors that each makes, and what each costs
report       tables, the page, CSV and JSON files; plots: the pictures
accuracy/    `study accuracy`: built-in problems with known solutions, and the settings of any scene
recommend/   `study recommend`: the cheapest setting of a scene that reaches a tolerance; what `check` predicts
scaling/     `study scaling`: strong and weak scaling over ranks, and a model of more ranks
hard_cases/  `study hard-cases`: what goes wrong in naive programs, and what must hold here
course.md    six exercises that lead from a serial loop to all of this
"""
