from optim.problem import Problem
def solve_source(problem, spacing, on_iterate): raise NotImplementedError
