// Nothing but the target of the headers that most files include; see RipsTargets.cmake.
