// That the agents of a robot may be away, as an operator said.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_MAINTENANCE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_MAINTENANCE_H_

#include <cstddef>
#include <cstdint>
#include <string>

namespace rips::store {

// Bytes of its reason.
inline constexpr size_t kMaintenanceReasonBytesMax = 1'000;

// At most one of each robot.
struct Maintenance {
  int64_t began_unix_ns = 0;
  // Above `began_unix_ns`; 0 = the robot is in none.
  int64_t until_unix_ns = 0;
  // Who asked for it: `NAME (URI serial NUMBER)`.
  std::string by;
  // The operator's words: any bytes.
  std::string reason;

  bool none() const { return until_unix_ns == 0; }

  friend bool operator==(const Maintenance&, const Maintenance&) = default;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_MAINTENANCE_H_
