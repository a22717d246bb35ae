// Which form of gid the ROS processes of a bus write in their claims (discovery_info.h). Humble and
// Iron give the message the same DDS type name and another layout, so a claim in the wrong form is
// delivered all the same, and misread: it names no node, or is an error in the reader's log.
#ifndef RIPS_SERVICES_ROS2_GID_FORM_H_
#define RIPS_SERVICES_ROS2_GID_FORM_H_

#include <cstddef>
#include <optional>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/string_view.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/guid.h"

namespace rips::ros2 {

// The form of a claim by its first bytes alone; nullopt = it is too short to be one. Of what
// DecodeParticipantEntities takes it is right; of anything else it means nothing.
std::optional<GidBytes> GidFormOf(absl::string_view payload);

// One vote for each participant. Not thread-safe.
//
// | heard                          | form                              |
// |--------------------------------|-----------------------------------|
// | nothing, or all voters left    | as before; at first `initial`     |
// | more of one form than of other | that one                          |
// | as many of each                | as before                         |
class GidFormVotes {
 public:
  // Further participants do not vote.
  static constexpr size_t kVotersMax = 4'096;

  explicit GidFormVotes(GidBytes initial) : form_(initial) {}

  // The newest claim of a participant counts.
  void Heard(const Guid& participant, GidBytes form);
  void Gone(const Guid& participant);
  // Removes those for which `stays` is false.
  template <typename Predicate>
  void Keep(const Predicate& stays) {
    absl::erase_if(votes_, [&](const auto& vote) { return !stays(vote.first); });
    Recount();
  }

  GidBytes form() const { return form_; }

 private:
  void Recount();

  absl::flat_hash_map<Guid, GidBytes> votes_;
  GidBytes form_;
};

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_GID_FORM_H_
