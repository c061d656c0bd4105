"""The withheld-effect benchmark: worlds, truths, populations, the sealed answers and the score.

Nothing here imports the diagnosis or the effects catalogue; `ask` alone calls the diagnosis, through the public verb,
and it never sees an answer.
"""
