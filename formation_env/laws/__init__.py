"""The paper's laws and conditions: planner, tracker, slots, gains, feasibility; and the action levels."""
