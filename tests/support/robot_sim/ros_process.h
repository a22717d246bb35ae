// What one ROS 2 Humble process over rmw_cyclonedds looks like from outside: a participant, its
// nodes with the endpoints every rclcpp node has, and the list of both on `ros_discovery_info`.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_ROS_PROCESS_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_ROS_PROCESS_H_

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_graph.h"
#include "tests/support/ros2/service_server.h"

namespace rips::robot_sim {

// QoS as rclcpp and its profiles give it.
ros2::Qos DefaultQos(uint32_t depth = 10);  // reliable, volatile
ros2::Qos SensorDataQos();                  // best effort, volatile, depth 5

// The parameters of a node as they are now. Called on the threads of its services.
using ParameterSource = std::function<actuator::ParameterMap()>;
// Sets all of them: empty, or why not. Called on the thread of the service.
using ParameterSink = std::function<std::string(const actuator::ParameterMap&)>;

// One node. Names are ROS names, absolute: "/camera/image_raw", "sensor_msgs/msg/Image". Not
// thread-safe while it is built; the writers it gives out are.
class RosNode {
 public:
  // With what rclcpp gives every node: log, parameter services, parameter events. get_parameters
  // and list_parameters answer, and set_parameters_atomically if there is a `sink`; the other
  // parameter services are there and stay silent.
  static absl::StatusOr<std::unique_ptr<RosNode>> Create(const dds::Participant& participant,
                                                         absl::string_view full_name,
                                                         ParameterSource parameters,
                                                         ParameterSink sink = {});

  // Only the endpoints that are added; what a program on plain DDS would have.
  static absl::StatusOr<std::unique_ptr<RosNode>> CreateBare(const dds::Participant& participant,
                                                             absl::string_view full_name);

  // The writer lives as long as the node.
  absl::StatusOr<dds::RawWriter*> Publish(absl::string_view topic, absl::string_view type,
                                          const ros2::Qos& qos);
  // `callback` may be empty; else see dds::RawCallback.
  absl::Status Subscribe(absl::string_view topic, absl::string_view type, const ros2::Qos& qos,
                         dds::RawCallback callback = {});
  // An empty `handler` never answers.
  absl::Status Serve(absl::string_view service, absl::string_view type,
                     dds::ServiceHandler handler = {});

  // The parameter services of Create.
  absl::Status AddParameterServices(ParameterSource parameters, ParameterSink sink);

  const std::string& full_name() const { return full_name_; }
  dds::RawWriter* log() const { return log_; }
  dds::RawWriter* parameter_events() const { return parameter_events_; }
  const ros2::NodeEntities& entities() const { return entities_; }

 private:
  RosNode(const dds::Participant& participant, absl::string_view full_name);

  const dds::Participant& participant_;  // Not owned; outlives this.
  std::string full_name_;
  ros2::NodeEntities entities_;
  std::vector<std::unique_ptr<dds::RawWriter>> writers_;
  std::vector<std::unique_ptr<dds::RawReader>> readers_;
  std::vector<std::unique_ptr<dds::ServiceServer>> services_;
  dds::RawWriter* log_ = nullptr;
  dds::RawWriter* parameter_events_ = nullptr;
};

// One process. Not thread-safe.
class RosProcess {
 public:
  static absl::StatusOr<std::unique_ptr<RosProcess>> Create(
      std::shared_ptr<const dds::Domain> domain, ros2::GidBytes gid_bytes,
      const dds::ParticipantOptions& participant = {});

  // The node lives as long as the process.
  absl::StatusOr<RosNode*> AddNode(absl::string_view full_name, ParameterSource parameters = {},
                                   ParameterSink sink = {});
  // Publishes the nodes and their endpoints as they are now; latched.
  absl::Status Announce();

  const std::vector<std::unique_ptr<RosNode>>& nodes() const { return nodes_; }
  const dds::Participant& participant() const { return *participant_; }

 private:
  RosProcess(std::unique_ptr<dds::Participant> participant, ros2::GidBytes gid_bytes)
      : participant_(std::move(participant)), gid_bytes_(gid_bytes) {}

  std::unique_ptr<dds::Participant> participant_;
  ros2::GidBytes gid_bytes_;
  std::unique_ptr<dds::RawWriter> discovery_writer_;
  std::unique_ptr<dds::RawReader> discovery_reader_;
  std::vector<std::unique_ptr<RosNode>> nodes_;
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_ROS_PROCESS_H_
