// Exactly-once in effect: which observations of one sensor host have been judged.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SEQUENCE_TRACK_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SEQUENCE_TRACK_H_

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/server/robot/model/inbound.h"

namespace rips::pipeline {

// Not thread-safe. Sequences count from 1 per (incarnation, lane).
class SequenceTrack {
 public:
  using Key = std::pair<std::string, Lane>;  // incarnation, lane

  struct Accepted {
    // How many observations at the front of the batch were judged before.
    size_t skip = 0;
    // How many sequence numbers before the batch never arrived (message lane only: they were shed).
    uint64_t missing = 0;
  };

  // What the store has, at the start: nothing is forgotten for it, since which of them is the
  // newest is not known.
  void Load(const std::string& incarnation, Lane lane, uint64_t judged);
  // A sensor announces it: of those that are known it is forgotten last.
  void Announce(const std::string& incarnation);
  // Forgets the incarnations that `other` does not know.
  void KeepOnly(const SequenceTrack& other);
  // Takes up to here as judged, of an incarnation that is announced.
  void Restore(const std::string& incarnation, Lane lane, uint64_t judged);

  // `first` is the batch's first sequence, `count` its length. InvalidArgument for sequence 0, one
  // past kSequenceMax, or a gap in the control lane, which is never shed.
  absl::StatusOr<Accepted> Accept(const std::string& incarnation, Lane lane, uint64_t first,
                                  size_t count);

  // Highest judged sequence; 0 = none.
  uint64_t Judged(const std::string& incarnation, Lane lane) const;
  // All that is known, for the checkpoint. Beyond kIncarnationsMax incarnations the one
  // that was seen least recently goes whenever one is seen.
  const std::map<Key, uint64_t>& all() const { return judged_; }

  static constexpr size_t kIncarnationsMax = 16;
  // What the store can hold; a peer that counts further is broken.
  static constexpr uint64_t kSequenceMax = uint64_t{1} << 62;

 private:
  void Touch(const std::string& incarnation);

  std::map<Key, uint64_t> judged_;
  // Oldest first.
  std::vector<std::string> recent_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SEQUENCE_TRACK_H_
