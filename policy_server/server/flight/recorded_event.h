// What a robot's rules were given, as events of a recording.
#ifndef RIPS_POLICY_SERVER_SERVER_FLIGHT_RECORDED_EVENT_H_
#define RIPS_POLICY_SERVER_SERVER_FLIGHT_RECORDED_EVENT_H_

#include <cstddef>
#include <memory>
#include <string>

#include "policy_server/policy/recording/recorded.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "services/ros2/ros_graph.h"

namespace rips::flight {

// A settled graph, all of it.
recording::RecordedGraph WholeGraph(const ros2::RosGraph& graph);

// Of its payload, the first `payload_bytes_max` bytes.
recording::RecordedMessage MessageOf(const pipeline::MessageSeen& seen, std::string sender,
                                     size_t payload_bytes_max);

recording::RecordedLevel LevelOf(const pipeline::LevelChange& level);

// Turns events into recorded ones, in their order. One that it is not given changes nothing but the
// next one's graph. Not thread-safe.
class EventConverter {
 public:
  // `state`: by which the next event is judged.
  explicit EventConverter(const pipeline::RulesState& state)
      : graph_(state.graph), context_due_(state.settled) {}

  recording::Recorded Convert(const pipeline::JudgedEvent& judged, size_t payload_bytes_max);
  recording::Recorded Convert(const pipeline::LevelChange& level);
  // What the events so far have led to is not known: the next one has its whole graph.
  void Forget() {
    context_due_ = true;
    findings_.reset();
  }

 private:
  // That the events so far have led to.
  std::shared_ptr<const ros2::RosGraph> graph_;
  // The next event has all of its graph.
  bool context_due_;
  // Of the event before.
  std::optional<engine::StandingFindings> findings_;
};

}  // namespace rips::flight

#endif  // RIPS_POLICY_SERVER_SERVER_FLIGHT_RECORDED_EVENT_H_
