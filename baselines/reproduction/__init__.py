"""The paper's figures and claims redone: motions, tables, claims and pictures for `baselines.paper`."""
