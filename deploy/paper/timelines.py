"""What is done to the robot in each timeline, in the robot's seconds, and which levels come of it.

Nothing orders a level but RIPS and, where it says so, an operator:

    ("go", PLACE)            the robot is sent to a place of its floor
    ("person",)              a person walks across the detour
    ("spy", "comes")         an unauthorised node subscribes to the camera
    ("driver", "comes")      an unauthorised node publishes on /cmd_vel
    (..., "leaves")          and ends
    ("lower", LEVEL, WHY)    the operator lowers the level with a reason

`levels` are the decisions that must follow, in this order, each with who makes it: a rule of
rules/experiment, or the operator. A robot has three lowerings by rules in ten minutes.
"""

SPY, DRIVER, CALM, OPERATOR = "unknown_reader", "unknown_driver", "calm", "operator"


def visits(*times):
    """A spy who comes and goes."""
    return [action for comes, leaves in times
            for action in ((comes, "spy", "comes"), (leaves, "spy", "leaves"))]


TIMELINES = {
    "main": {
        "title": "The paper's timeline",
        "seconds": 102,
        "actions": [
            (5, "go", "B"),
            (12, "spy", "comes"),
            (26, "person"),
            (40, "driver", "comes"),
            (45, "driver", "leaves"),
            (47, "lower", "ALERT", "second driver found and removed"),
            (70, "spy", "leaves"),
            (72, "go", "A"),
        ],
        "levels": [("ALERT", SPY), ("COMPROMISED", DRIVER), ("ALERT", OPERATOR),
                   ("DEFAULT", CALM)],
    },
    "long": {
        "title": "Camera off for long",
        "seconds": 100,
        "actions": [(5, "go", "B"), *visits((12, 82))],
        "levels": [("ALERT", SPY), ("DEFAULT", CALM)],
    },
    "multiple": {
        "title": "Camera off several times",
        "seconds": 90,
        "actions": visits((10, 24), (38, 52), (66, 78)),
        "levels": 3 * [("ALERT", SPY), ("DEFAULT", CALM)],
    },
    "short": {
        "title": "Camera off for a short time",
        "seconds": 40,
        "actions": [(5, "go", "B"), *visits((12, 20))],
        "levels": [("ALERT", SPY), ("DEFAULT", CALM)],
    },
    "multiple-long": {
        "title": "Camera off several times, on for long between them",
        "seconds": 100,
        "actions": visits((10, 20), (60, 70), (82, 90)),
        "levels": 3 * [("ALERT", SPY), ("DEFAULT", CALM)],
    },
}
