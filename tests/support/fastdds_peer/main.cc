// A node of rmw_fastrtps as the bus sees it: one participant of Fast DDS, its entities on
// `ros_discovery_info` with gids of 24 bytes, topics, a service that is served or called.
//
//   fastdds_peer --domain 7 --node /talker --publish rt/chatter [--latched]
//   fastdds_peer --domain 7 --node /server --serve /enable
//   fastdds_peer --domain 7 --node /client --call /enable
//   fastdds_peer --domain 7 --node /manager --modes /safety --mode __DEFAULT__ --mode ALERT
//
// The last is a mode manager of one part: it takes any of the modes it was given, is in it at once,
// and prints `order MODE`. Topics are std_msgs/msg/String, services std_srvs/srv/SetBool. Prints
// `up`, `ready` when the service counts as available (by the rule of rmw_fastrtps: as many readers
// of requests as writers of replies are known, and all are matched), `reply` for each answer,
// `counts READERS WRITERS` when those of the service change. SIGTERM ends it.
#include <csignal>
#include <cstdio>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/time/time.h"
#include "fastdds/dds/domain/DomainParticipant.hpp"
#include "fastdds/dds/domain/DomainParticipantFactory.hpp"
#include "fastdds/dds/domain/DomainParticipantListener.hpp"
#include "fastdds/dds/publisher/DataWriter.hpp"
#include "fastdds/dds/publisher/Publisher.hpp"
#include "fastdds/dds/subscriber/DataReader.hpp"
#include "fastdds/dds/subscriber/DataReaderListener.hpp"
#include "fastdds/dds/subscriber/SampleInfo.hpp"
#include "fastdds/dds/subscriber/Subscriber.hpp"
#include "fastdds/dds/topic/TopicDataType.hpp"
#include "fastdds/rtps/transport/UDPv4TransportDescriptor.h"
#include "services/ros2/cdr.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/mutex.h"
#include "services/runtime/shutdown.h"
#include "tests/support/robot_sim/stop_flag.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::fastdds_peer {
namespace {

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

constexpr char kStringType[] = "std_msgs::msg::dds_::String_";
constexpr char kServiceType[] = "std_srvs/srv/SetBool";
constexpr uint32_t kPayloadBytesMax = 64 * 1024;

struct Options {
  uint32_t domain = 0;
  std::string node;
  std::string publish;
  bool latched = false;
  bool udp_only = false;
  std::string serve;
  std::string call;
  std::string modes;
  std::vector<std::string> mode;
};

void Say(const std::string& text) {
  std::printf("%s\n", text.c_str());
  std::fflush(stdout);
}

// A sample is a std::string that holds the payload as it goes over the wire.
class RawType : public fast::TopicDataType {
 public:
  explicit RawType(const std::string& name) {
    setName(name.c_str());
    m_typeSize = kPayloadBytesMax;
    m_isGetKeyDefined = false;
    auto_fill_type_information(false);
    auto_fill_type_object(false);
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    const auto& bytes = *static_cast<std::string*>(data);
    if (bytes.size() > payload->max_size) return false;
    payload->encapsulation = CDR_LE;
    payload->length = static_cast<uint32_t>(bytes.size());
    std::memcpy(payload->data, bytes.data(), bytes.size());
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
    static_cast<std::string*>(data)->assign(reinterpret_cast<char*>(payload->data),
                                            payload->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<uint32_t>(static_cast<std::string*>(data)->size()); };
  }
  void* createData() override { return new std::string; }
  void deleteData(void* data) override { delete static_cast<std::string*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

ros2::Guid ToGuid(const rtps::GUID_t& guid) {
  ros2::Guid copy;
  std::memcpy(copy.bytes.data(), guid.guidPrefix.value, 12);
  std::memcpy(copy.bytes.data() + 12, guid.entityId.value, 4);
  return copy;
}

// Readers of requests and writers of replies that discovery has told of.
class Graph : public fast::DomainParticipantListener {
 public:
  void Follow(const std::string& request, const std::string& reply) {
    MutexLock lock(&mu_);
    request_ = request;
    reply_ = reply;
  }
  void on_subscriber_discovery(fast::DomainParticipant*,
                               rtps::ReaderDiscoveryInfo&& info) override {
    const bool there = info.status == rtps::ReaderDiscoveryInfo::DISCOVERED_READER ||
                       info.status == rtps::ReaderDiscoveryInfo::CHANGED_QOS_READER;
    MutexLock lock(&mu_);
    if (info.info.topicName().to_string() != request_) return;
    Count(readers_, ToGuid(info.info.guid()), there);
  }
  void on_publisher_discovery(fast::DomainParticipant*, rtps::WriterDiscoveryInfo&& info) override {
    const bool there = info.status == rtps::WriterDiscoveryInfo::DISCOVERED_WRITER ||
                       info.status == rtps::WriterDiscoveryInfo::CHANGED_QOS_WRITER;
    MutexLock lock(&mu_);
    if (info.info.topicName().to_string() != reply_) return;
    Count(writers_, ToGuid(info.info.guid()), there);
  }
  std::pair<size_t, size_t> Counts() {
    MutexLock lock(&mu_);
    return {readers_.size(), writers_.size()};
  }

 private:
  using Set = std::map<ros2::Guid, bool>;
  void Count(Set& set, const ros2::Guid& guid, bool there) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (there ? !set.emplace(guid, true).second : set.erase(guid) == 0) return;
    Say("counts " + std::to_string(readers_.size()) + " " + std::to_string(writers_.size()));
  }

  Mutex mu_;
  std::string request_ ABSL_GUARDED_BY(mu_);
  std::string reply_ ABSL_GUARDED_BY(mu_);
  Set readers_ ABSL_GUARDED_BY(mu_);
  Set writers_ ABSL_GUARDED_BY(mu_);
};

using OnSample = std::function<void(const std::string&, const fast::SampleInfo&)>;

class ReaderListener : public fast::DataReaderListener {
 public:
  explicit ReaderListener(OnSample on_sample) : on_sample_(std::move(on_sample)) {}
  void on_data_available(fast::DataReader* reader) override {
    std::string payload;
    fast::SampleInfo info;
    while (reader->take_next_sample(&payload, &info) == ReturnCode_t::RETCODE_OK) {
      if (info.valid_data) on_sample_(payload, info);
    }
  }

 private:
  const OnSample on_sample_;
};

class Peer {
 public:
  explicit Peer(const Options& options) : options_(options) {}
  ~Peer() {
    if (participant_ == nullptr) return;
    participant_->set_listener(nullptr);
    participant_->delete_contained_entities();
    fast::DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }

  bool Start() {
    fast::DomainParticipantQos qos;
    const std::string enclave = "enclave=/;";
    qos.user_data().data_vec({enclave.begin(), enclave.end()});
    if (options_.udp_only) {
      qos.transport().use_builtin_transports = false;
      qos.transport().user_transports.push_back(
          std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>());
    }
    const std::string service = options_.serve.empty() ? options_.call : options_.serve;
    if (!service.empty()) {
      graph_.Follow(ros2::MangleServiceRequest(service), ros2::MangleServiceReply(service));
    }
    participant_ = fast::DomainParticipantFactory::get_instance()->create_participant(
        options_.domain, qos, &graph_, fast::StatusMask::none());
    if (participant_ == nullptr) return false;
    publisher_ = participant_->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    subscriber_ = participant_->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    info_ = Writer(ros2::kDiscoveryTopic, ros2::kDiscoveryType, /*latched=*/true, 1);
    Reader(ros2::kDiscoveryTopic, ros2::kDiscoveryType, /*latched=*/true, {});
    if (!options_.publish.empty()) {
      Own(topic_ = Writer(options_.publish, kStringType, options_.latched, 7));
    }
    if (!options_.serve.empty()) Serve(options_.serve, kServiceType, SetBool);
    if (!options_.modes.empty()) ServeModes();
    if (!options_.call.empty()) Client();
    return Claim();
  }

  void Run(robot_sim::StopFlag& stop) {
    bool ready = false;
    while (!stop.WaitFor(absl::Milliseconds(20))) {
      if (topic_ != nullptr) {
        ros2::CdrWriter cdr;
        cdr.String("hello");
        std::string payload = std::move(cdr).Finish();
        topic_->write(&payload);
      }
      if (options_.call.empty() || !Available()) continue;
      if (!std::exchange(ready, true)) Say("ready");
      Call();
    }
  }

 private:
  fast::Topic* Topic(const std::string& name, const std::string& type) {
    fast::TypeSupport(new RawType(type)).register_type(participant_);
    if (auto* known = dynamic_cast<fast::Topic*>(participant_->lookup_topicdescription(name))) {
      return known;
    }
    return participant_->create_topic(name, type, fast::TOPIC_QOS_DEFAULT);
  }
  fast::DataWriter* Writer(const std::string& name, const std::string& type, bool latched,
                           int depth) {
    fast::DataWriterQos qos;
    qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind =
        latched ? fast::TRANSIENT_LOCAL_DURABILITY_QOS : fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = depth;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    return publisher_->create_datawriter(Topic(name, type), qos);
  }
  fast::DataReader* Reader(const std::string& name, const std::string& type, bool latched,
                           OnSample on_sample) {
    fast::DataReaderQos qos;
    qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind =
        latched ? fast::TRANSIENT_LOCAL_DURABILITY_QOS : fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 100;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    if (!on_sample) on_sample = [](const std::string&, const fast::SampleInfo&) {};
    listeners_.push_back(std::make_unique<ReaderListener>(std::move(on_sample)));
    return subscriber_->create_datareader(Topic(name, type), qos, listeners_.back().get());
  }
  void Own(fast::DataWriter* writer) { entities_.writers.push_back(ToGuid(writer->guid())); }
  void Own(fast::DataReader* reader) { entities_.readers.push_back(ToGuid(reader->guid())); }

  bool Claim() {
    const size_t slash = options_.node.rfind('/');
    entities_.node_namespace = slash == 0 ? "/" : options_.node.substr(0, slash);
    entities_.node_name = options_.node.substr(slash + 1);
    std::string payload =
        ros2::EncodeParticipantEntities({.participant = ToGuid(participant_->guid()),
                                         .nodes = {entities_},
                                         .gid_bytes = ros2::GidBytes::k24});
    return info_->write(&payload);
  }

  using Answer = std::function<std::string(const std::string& request)>;

  static std::string SetBool(const std::string&) {
    ros2::CdrWriter cdr;
    cdr.Bool(true);
    cdr.String("done");
    return std::move(cdr).Finish();
  }

  // The reply goes to whom the request names, or else to its writer, under the request's number.
  void Serve(const std::string& service, const std::string& type, Answer answer) {
    fast::DataWriter* const reply =
        Writer(ros2::MangleServiceReply(service), ros2::MangleServiceReplyType(type), false, 10);
    Own(reply);
    Own(Reader(ros2::MangleServiceRequest(service), ros2::MangleServiceRequestType(type), false,
               [reply, answer = std::move(answer)](const std::string& request,
                                                   const fast::SampleInfo& info) {
                 rtps::WriteParams to;
                 to.related_sample_identity() = info.sample_identity;
                 const rtps::GUID_t& named = info.related_sample_identity.writer_guid();
                 if (named != rtps::GUID_t::unknown()) {
                   to.related_sample_identity().writer_guid() = named;
                 }
                 std::string payload = answer(request);
                 reply->write(&payload, to);
               }));
  }

  void ServeModes() {
    const std::string& part = options_.modes;
    {
      MutexLock lock(&mu_);
      now_ = options_.mode.empty() ? "" : options_.mode[0];
    }
    Serve(part + "/change_mode", ros2::kChangeModeType, [this](const std::string& request) {
      const auto mode = ros2::DecodeChangeModeRequest(request);
      bool known = false;
      for (const std::string& each : options_.mode) known |= mode.ok() && *mode == each;
      MutexLock lock(&mu_);
      if (known) now_ = *mode;
      Say("order " + (mode.ok() ? *mode : std::string("?")));
      return ros2::EncodeSuccessReply(known);
    });
    Serve(part + "/get_mode", ros2::kGetModeType, [this](const std::string&) {
      MutexLock lock(&mu_);
      return ros2::EncodeGetModeReply(now_);
    });
    Serve(part + "/get_state", ros2::kGetStateType, [](const std::string&) {
      return ros2::EncodeGetStateReply({3, "active"});
    });
    Serve(part + "/get_available_modes", ros2::kGetAvailableModesType,
          [this](const std::string&) { return ros2::EncodeGetAvailableModesReply(options_.mode); });
  }

  void Client() {
    request_ = Writer(ros2::MangleServiceRequest(options_.call),
                      ros2::MangleServiceRequestType(kServiceType), false, 10);
    replies_ =
        Reader(ros2::MangleServiceReply(options_.call), ros2::MangleServiceReplyType(kServiceType),
               false, [this](const std::string&, const fast::SampleInfo& info) {
                 if (info.related_sample_identity.writer_guid() == replies_->guid()) {
                   Say("reply");
                 }
               });
    Own(request_);
    Own(replies_);
  }

  bool Available() {
    const auto [readers, writers] = graph_.Counts();
    if (readers == 0 || readers != writers) return false;
    fast::PublicationMatchedStatus requests;
    fast::SubscriptionMatchedStatus replies;
    request_->get_publication_matched_status(requests);
    replies_->get_subscription_matched_status(replies);
    return requests.current_count > 0 && requests.current_count == replies.current_count;
  }

  void Call() {
    rtps::WriteParams to;
    to.related_sample_identity().writer_guid() = replies_->guid();
    ros2::CdrWriter cdr;
    cdr.Bool(true);
    std::string payload = std::move(cdr).Finish();
    request_->write(&payload, to);
  }

  const Options options_;
  Graph graph_;
  Mutex mu_;
  std::string now_ ABSL_GUARDED_BY(mu_);  // the mode
  ros2::NodeEntities entities_;
  std::vector<std::unique_ptr<ReaderListener>> listeners_;
  fast::DomainParticipant* participant_ = nullptr;
  fast::Publisher* publisher_ = nullptr;
  fast::Subscriber* subscriber_ = nullptr;
  fast::DataWriter* info_ = nullptr;
  fast::DataWriter* topic_ = nullptr;
  fast::DataWriter* request_ = nullptr;
  fast::DataReader* replies_ = nullptr;
};

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("a node on Fast DDS");
  app.add_option("--domain", options.domain)->required();
  app.add_option("--node", options.node)->required();
  app.add_option("--publish", options.publish);
  app.add_flag("--latched", options.latched);
  app.add_flag("--udp-only", options.udp_only);
  app.add_option("--serve", options.serve);
  app.add_option("--call", options.call);
  app.add_option("--modes", options.modes);
  app.add_option("--mode", options.mode);
  CLI11_PARSE(app, argc, argv);
  BlockSignals();
  robot_sim::StopFlag stop;
  SignalWaiter signals({{SIGTERM, [&stop] { stop.Stop(); }}});
  Peer peer(options);
  if (!peer.Start()) {
    std::fprintf(stderr, "cannot start\n");
    return 1;
  }
  Say("up");
  peer.Run(stop);
  return 0;
}

}  // namespace
}  // namespace rips::fastdds_peer

int main(int argc, char** argv) { return rips::fastdds_peer::Main(argc, argv); }
