// How often a randomized test repeats itself.
#ifndef RIPS_SERVICES_BASE_TEST_ROUNDS_H_
#define RIPS_SERVICES_BASE_TEST_ROUNDS_H_

namespace rips {

// `all`, or a fifth of it under a sanitizer, where a round costs some twenty times as much.
template <typename T>
constexpr T Rounds(T all) {
#ifdef RIPS_SANITIZED
  return all / 5;
#else
  return all;
#endif
}

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_TEST_ROUNDS_H_
