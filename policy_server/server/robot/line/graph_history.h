// The last versions of a robot's graph, so that a message is judged against the one under which it
// was taken. The graph and the messages come on two lanes that keep no order between them: without
// this, a robot that boots or stops looks like an attack.
//
// Which version judges a message (first line that fits):
//
// | the message                                         | is judged                            |
// |-----------------------------------------------------|--------------------------------------|
// | names no version                                    | at once, against the newest          |
// | is of an earlier incarnation of the sensor, of      | at once, against the graph that came |
// | which no version is held                            | with it, or else the newest          |
// | has no known writer, and its version has come       | at once, against the oldest version  |
// |                                                     | held that is not older               |
// | has a writer that such a version shows (not as      | at once, against the oldest of them  |
// | pending)                                            |                                      |
// | names a version older than all that are held        | at once, against the oldest          |
// | is of an earlier incarnation of the sensor          | at once, against its last version    |
// | has a version that has come, but the newest graph   | at once, against the newest          |
// | is truncated, or its writer was given up before     |                                      |
// | else                                                | when such a version comes            |
//
// The caller bounds the wait and then calls GiveUp.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_GRAPH_HISTORY_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_GRAPH_HISTORY_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>

#include "absl/container/flat_hash_set.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "services/base/clock.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

// Not thread-safe. Times are CLOCK_BOOTTIME.
class GraphHistory {
 public:
  using Version = engine::CurrentGraph::Version;

  // Beside the newest version: so many are held, with so many endpoints in all, so long after they
  // were replaced.
  static constexpr size_t kVersionsMax = 64;
  static constexpr size_t kEndpointsMax = 16'384;
  static constexpr int64_t kKeptNs = 10 * kNanosPerSecond;
  // Writers that were given up; more are waited for each time.
  static constexpr size_t kGivenUpMax = 1'024;

  struct Choice {
    bool wait = false;
    // Holds while the history does not change.
    const Version* version = nullptr;
    // In that version; null if it does not show the writer.
    const ros2::Endpoint* writer = nullptr;
    // Given up before: no node is known of it.
    bool unattributed = false;
    // No graph of its time is held or came with it, and the newest one, which judges it, does not
    // show its writer.
    bool outlived = false;
  };

  // `graph` is in force from now on: version `number` of `incarnation`, counting up.
  void Add(const std::string& incarnation, uint64_t number, Version graph, int64_t now_ns);
  // Drops what was replaced long ago, unless a backlog may still name it.
  void Expire(int64_t now_ns, bool backlog);

  // Of a message of `incarnation` that names version `number`. `live`: the sensor's session is of
  // this incarnation. `newest` is the graph in force; it need not be held here. `brought` came with
  // the message; null = none did.
  Choice Choose(const std::string& incarnation, bool live, uint64_t number,
                const ros2::Guid& writer, const Version& newest, const Version* brought) const;
  // Nothing shows this writer in time: its messages do not wait again until the graph changes.
  void GiveUp(const ros2::Guid& writer);

  // Of the newest version; 0 = none.
  uint64_t number() const { return held_.empty() ? 0 : held_.back().number; }
  size_t size() const { return held_.size(); }

 private:
  struct Held {
    std::string incarnation;
    uint64_t number = 0;
    Version graph;
    // 0 = it is the newest.
    int64_t replaced_ns = 0;
  };
  void DropOldest();

  // Oldest first.
  std::deque<Held> held_;
  // Of all but the newest.
  size_t endpoints_ = 0;
  absl::flat_hash_set<ros2::Guid> given_up_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_GRAPH_HISTORY_H_
