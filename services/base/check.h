// RIPS_CHECK(cond, why): a programmer's error ends the process, in every build. Never used on
// anything that came from outside the process.
#ifndef RIPS_SERVICES_BASE_CHECK_H_
#define RIPS_SERVICES_BASE_CHECK_H_

#include <cstdio>
#include <cstdlib>

#define RIPS_CHECK(cond, why)                                                                \
  do {                                                                                       \
    if (!(cond)) {                                                                           \
      std::fprintf(stderr, "%s:%d: check failed: %s: %s\n", __FILE__, __LINE__, #cond, why); \
      std::abort();                                                                          \
    }                                                                                        \
  } while (false)

#endif  // RIPS_SERVICES_BASE_CHECK_H_
