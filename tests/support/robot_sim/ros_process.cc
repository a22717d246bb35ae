#include "tests/support/robot_sim/ros_process.h"

#include <cstddef>
#include <optional>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::robot_sim {
namespace {

// Depths of rclcpp 16 (Humble).
constexpr uint32_t kLogDepth = 1'000;
constexpr uint32_t kParameterEventsDepth = 1'000;
constexpr uint32_t kSensorDataDepth = 5;

constexpr absl::string_view kSilentParameterServices[][2] = {
    {"get_parameter_types", "GetParameterTypes"},
    {"set_parameters", "SetParameters"},
    {"describe_parameters", "DescribeParameters"},
};

std::optional<std::string> AnswerGetParameters(const ParameterSource& source,
                                               absl::string_view request) {
  const absl::StatusOr<std::vector<std::string>> names = ros2::DecodeGetParametersRequest(request);
  if (!names.ok()) {
    return std::nullopt;
  }
  const actuator::ParameterMap parameters = source();
  std::vector<ros2::ParameterValue> values;
  for (const std::string& name : *names) {
    const auto it = parameters.find(name);
    if (it == parameters.end()) {
      // rclcpp refuses the whole request if one name is not declared.
      return ros2::EncodeGetParametersReply({});
    }
    values.push_back(it->second);
  }
  return ros2::EncodeGetParametersReply(values);
}

std::optional<std::string> AnswerSetParameters(const ParameterSink& sink,
                                               absl::string_view request) {
  const auto parameters = ros2::DecodeSetParametersRequest(request);
  if (!parameters.ok() || !sink) {
    return std::nullopt;
  }
  actuator::ParameterMap wanted;
  for (const ros2::NamedParameter& parameter : *parameters) {
    wanted[parameter.name] = parameter.value;
  }
  const std::string problem = sink(wanted);
  return ros2::EncodeSetParametersReply({.successful = problem.empty(), .reason = problem});
}

std::string AnswerListParameters(const ParameterSource& source) {
  std::vector<std::string> names;
  for (const auto& [name, unused] : source()) {
    names.push_back(name);
  }
  return EncodeListParametersReply(names);
}

ParameterSource WithSimTime(ParameterSource source) {
  return [source = std::move(source)] {
    actuator::ParameterMap parameters = source ? source() : actuator::ParameterMap();
    parameters.emplace("use_sim_time", false);
    return parameters;
  };
}

}  // namespace

ros2::Qos DefaultQos(uint32_t depth) { return {.reliable = true, .depth = depth}; }

ros2::Qos SensorDataQos() { return {.reliable = false, .depth = kSensorDataDepth}; }

RosNode::RosNode(const dds::Participant& participant, absl::string_view full_name)
    : participant_(participant), full_name_(full_name) {
  const size_t slash = full_name_.rfind('/');
  entities_.node_namespace = slash == 0 ? "/" : full_name_.substr(0, slash);
  entities_.node_name = full_name_.substr(slash + 1);
}

absl::StatusOr<std::unique_ptr<RosNode>> RosNode::CreateBare(const dds::Participant& participant,
                                                             absl::string_view full_name) {
  RIPS_RETURN_IF_ERROR(ros2::ValidateNodeName(full_name));
  return std::unique_ptr<RosNode>(new RosNode(participant, full_name));
}

absl::StatusOr<std::unique_ptr<RosNode>> RosNode::Create(const dds::Participant& participant,
                                                         absl::string_view full_name,
                                                         ParameterSource parameters,
                                                         ParameterSink sink) {
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<RosNode> node, CreateBare(participant, full_name));
  ros2::Qos latched = DefaultQos(kLogDepth);
  latched.transient_local = true;
  RIPS_ASSIGN_OR_RETURN(node->log_, node->Publish("/rosout", "rcl_interfaces/msg/Log", latched));
  RIPS_RETURN_IF_ERROR(
      node->AddParameterServices(WithSimTime(std::move(parameters)), std::move(sink)));
  const ros2::Qos events = DefaultQos(kParameterEventsDepth);
  constexpr absl::string_view kEvent = "rcl_interfaces/msg/ParameterEvent";
  RIPS_ASSIGN_OR_RETURN(node->parameter_events_,
                        node->Publish("/parameter_events", kEvent, events));
  RIPS_RETURN_IF_ERROR(node->Subscribe("/parameter_events", kEvent, events));
  return node;
}

absl::Status RosNode::AddParameterServices(ParameterSource parameters, ParameterSink sink) {
  RIPS_RETURN_IF_ERROR(Serve(absl::StrCat(full_name_, "/set_parameters_atomically"),
                             ros2::kSetParametersAtomicallyType,
                             [sink = std::move(sink)](absl::string_view request) {
                               return AnswerSetParameters(sink, request);
                             }));
  RIPS_RETURN_IF_ERROR(Serve(absl::StrCat(full_name_, "/get_parameters"), ros2::kGetParametersType,
                             [parameters](absl::string_view request) {
                               return AnswerGetParameters(parameters, request);
                             }));
  RIPS_RETURN_IF_ERROR(
      Serve(absl::StrCat(full_name_, "/list_parameters"), "rcl_interfaces/srv/ListParameters",
            [parameters](absl::string_view) { return AnswerListParameters(parameters); }));
  for (const auto& [service, type] : kSilentParameterServices) {
    RIPS_RETURN_IF_ERROR(
        Serve(absl::StrCat(full_name_, "/", service), absl::StrCat("rcl_interfaces/srv/", type)));
  }
  return absl::OkStatus();
}

absl::StatusOr<dds::RawWriter*> RosNode::Publish(absl::string_view topic, absl::string_view type,
                                                 const ros2::Qos& qos) {
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::RawWriter> writer,
                        dds::RawWriter::Create(participant_, {.topic = ros2::MangleTopic(topic),
                                                              .type = ros2::MangleType(type),
                                                              .qos = qos}));
  entities_.writers.push_back(writer->guid());
  writers_.push_back(std::move(writer));
  return writers_.back().get();
}

absl::Status RosNode::Subscribe(absl::string_view topic, absl::string_view type,
                                const ros2::Qos& qos, dds::RawCallback callback) {
  if (!callback) {
    callback = [](const dds::RawSample&) {};
  }
  RIPS_ASSIGN_OR_RETURN(
      std::unique_ptr<dds::RawReader> reader,
      dds::RawReader::Create(participant_,
                             {.topic = ros2::MangleTopic(topic),
                              .type = ros2::MangleType(type),
                              .reliable_transient_local = qos.reliable && qos.transient_local,
                              .reliable = qos.reliable,
                              .depth = qos.depth,
                              .every_partition = false,
                              .ignore_own = false},
                             std::move(callback)));
  entities_.readers.push_back(reader->guid());
  readers_.push_back(std::move(reader));
  return absl::OkStatus();
}

absl::Status RosNode::Serve(absl::string_view service, absl::string_view type,
                            dds::ServiceHandler handler) {
  if (!handler) {
    handler = [](absl::string_view) { return std::nullopt; };
  }
  RIPS_ASSIGN_OR_RETURN(
      std::unique_ptr<dds::ServiceServer> server,
      dds::ServiceServer::Create(participant_,
                                 {.service = std::string(service), .type = std::string(type)},
                                 std::move(handler)));
  entities_.readers.push_back(server->request_reader());
  entities_.writers.push_back(server->reply_writer());
  services_.push_back(std::move(server));
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<RosProcess>> RosProcess::Create(
    std::shared_ptr<const dds::Domain> domain, ros2::GidBytes gid_bytes,
    const dds::ParticipantOptions& options) {
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::Participant> participant,
                        dds::Participant::Create(std::move(domain), options));
  std::unique_ptr<RosProcess> process(new RosProcess(std::move(participant), gid_bytes));
  RIPS_ASSIGN_OR_RETURN(
      process->discovery_writer_,
      dds::RawWriter::Create(*process->participant_,
                             {.topic = ros2::kDiscoveryTopic,
                              .type = ros2::kDiscoveryType,
                              .qos = {.reliable = true, .transient_local = true, .depth = 1}}));
  RIPS_ASSIGN_OR_RETURN(process->discovery_reader_,
                        dds::RawReader::Create(*process->participant_,
                                               {.topic = ros2::kDiscoveryTopic,
                                                .type = ros2::kDiscoveryType,
                                                .reliable_transient_local = true,
                                                .keep_all = true,
                                                .every_partition = false},
                                               [](const dds::RawSample&) {}));
  return process;
}

absl::StatusOr<RosNode*> RosProcess::AddNode(absl::string_view full_name,
                                             ParameterSource parameters, ParameterSink sink) {
  RIPS_ASSIGN_OR_RETURN(
      std::unique_ptr<RosNode> node,
      RosNode::Create(*participant_, full_name, std::move(parameters), std::move(sink)));
  nodes_.push_back(std::move(node));
  return nodes_.back().get();
}

absl::Status RosProcess::Announce() {
  ros2::ParticipantEntities info{.participant = participant_->guid(), .gid_bytes = gid_bytes_};
  for (const std::unique_ptr<RosNode>& node : nodes_) {
    info.nodes.push_back(node->entities());
  }
  return discovery_writer_->Write(ros2::EncodeParticipantEntities(info));
}

}  // namespace rips::robot_sim
