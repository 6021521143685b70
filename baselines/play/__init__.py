"""A live page to play with: `python -m baselines.play`, or `formation-play`; needs the extra `web`.

    pip install "formation-env[web]"
    formation-play --policies expert,dagger --scenario swarm

It serves one page on 127.0.0.1 and opens it in the browser. A thread of the server flies the policies in
real time, however many pages are open: all show the same flight, each as fast as it can, and one that is
closed and opened again finds it where it then is.

- *Controls* are made from the fields of `FormationConfig` and of its parts (`controls`): a new field is a
  new control, with the unit and the words of the comment beside it. What differs from the scenario is
  marked, and shown as the Python that makes it (`settings`). What the configuration refuses is shown with
  its own message, and the flight goes on as it was.
- *A changed value* takes effect in flight (`carrying`): vehicles, actuators, disturbances and measurements
  stay where they are, the expert keeps its virtual followers, other policies that remember begin anew.
  Where another path is flown, at another action level or control period, or with more followers, the
  episode begins anew from the same seed.
- *A push* changes the true velocity of a vehicle at once, in the state of the simulation.
- *A lost follower* is gone at once: the configuration is one without it, and the others fly on where they
  are. Its own fall is not flown, since a vehicle that hits the floor ends the episode for all.
- *Two policies* side by side fly the same configuration from the same seed, and are pushed alike.

When an episode has ended, the next seed's begins after some seconds.
"""

from baselines.play.command import main, parser

__all__ = ["main", "parser"]
