// Memory of a daemon holds keys, payloads and rules. It must not be written anywhere.
#ifndef RIPS_SERVICES_RUNTIME_CORE_DUMPS_H_
#define RIPS_SERVICES_RUNTIME_CORE_DUMPS_H_

namespace rips {

// From now on this process leaves no core dump, whatever the system's core_pattern is, and no other
// process of its user reads its memory (PR_SET_DUMPABLE). Its children have a core limit of 0; one
// that executes a program is dumpable again. Logs if the system refuses. Call it first in main().
void ForbidCoreDumps();

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_CORE_DUMPS_H_
