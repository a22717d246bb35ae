// Which files a process may open.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_LANDLOCK_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_LANDLOCK_H_

#include <string>
#include <vector>

namespace rips::inspect {

// What the dynamic loader, shells and interpreters read besides their own: /usr with /lib and /bin,
// the loader's cache, the time zone, Python's site files, descriptions of processor and memory.
std::vector<std::string> SystemReadable();

// For this process and what it becomes and starts, for good: `readable` may be read and executed,
// `devices` read and written, no other file opened, made, removed or renamed, and no process
// outside traced or its memory opened. Needs no_new_privs. What is not there is left out. Empty, or
// what of it this kernel cannot enforce.
std::string ApplyLandlock(const std::vector<std::string>& readable,
                          const std::vector<std::string>& devices);

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_LANDLOCK_H_
