// A recording on its way to an operator.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECORD_TAP_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECORD_TAP_H_

#include <functional>
#include <memory>
#include <utility>

#include "policy_server/server/robot/ports.h"
#include "rips/v1/recording.pb.h"
#include "services/ros2/ros_graph.h"

namespace rips::operator_api {

// Holds what the rules were given: messages that they do not need are neither sent by the robot nor
// recorded.
class RecordingWriter final : public pipeline::EventRecorder {
 public:
  // False when nobody listens any more.
  using Send = std::function<bool(rips::v1::Recording)>;

  // `listening`: false when nobody listens any more.
  RecordingWriter(Send send, std::function<bool()> listening)
      : send_(std::move(send)), listening_(std::move(listening)) {}

  // Header and graph; before the first event. `settled`: there is a graph.
  void Start(rips::v1::RecordingHeader header, std::shared_ptr<const ros2::RosGraph> graph,
             bool settled);
  bool OnEvent(const pipeline::JudgedEvent& judged) override;
  bool OnLevel(const pipeline::LevelChange& level) override;

 private:
  Send send_;
  std::function<bool()> listening_;
  // The one that the recording has come to.
  std::shared_ptr<const ros2::RosGraph> graph_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECORD_TAP_H_
