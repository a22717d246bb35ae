#include "policy_server/server/ingest/sensor_service.h"

#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/ingest/interest_codec.h"
#include "policy_server/server/ingest/observation_decoder.h"
#include "policy_server/server/shard/agent_alerts.h"
#include "policy_server/server/shard/mailbox.h"
#include "services/model_proto/configuration_codec.h"
#include "services/ros2/ros_name.h"
#include "services/rpc/peer.h"
#include "services/rpc/peer_address.h"
#include "services/rpc/server_stream.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/log.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "services/wire_limits/field_limits.h"
#include "services/wire_limits/parsed_size.h"

namespace rips::ingest {
namespace {

using pipeline::Lane;
using pipeline::Robot;
using rips::v1::SensorMessage;
using rips::v1::SensorReply;
using Stream = rpc::ServerStream<SensorMessage, SensorReply>;

// What the pipeline holds of one stream.
class Link final : public pipeline::SensorLink {
 public:
  Link(std::shared_ptr<Stream::Outbound> outbound, LogLimiter* logs,
       pipeline::AgentContacts* contacts)
      : outbound_(std::move(outbound)), logs_(logs), contacts_(contacts) {}

  // Once, before the hello is posted.
  void SetPeer(std::string robot, std::string host, std::string address,
               const rips::v1::SensorHello& in) ABSL_LOCKS_EXCLUDED(mu_) {
    const rips::v1::Hello& hello = in.hello();
    robot_ = std::move(robot);
    host_ = std::move(host);
    address_ = std::move(address);
    said_ = {.version = hello.version(), .address = rpc::AddressOfPeer(address_)};
    if (hello.has_configuration()) {
      said_.configuration = model_proto::Bounded(hello.configuration()).SerializeAsString();
    }
    // The sensor's word. What cannot be an id of ours is none.
    MutexLock lock(&mu_);
    if (in.interest_in_use().size() == kInterestIdBytes) interest_ = in.interest_in_use();
  }
  // A message has come. Noted of an agent that was admitted: what others say with its key counts
  // for nothing.
  void Heard(int64_t boottime_ns) {
    if (admitted_ && heard_ != nullptr) *heard_ = boottime_ns;
  }

  void Setup(const pipeline::SensorSetup& setup) override {
    if (!admitted_) {
      if (contacts_ != nullptr) {
        heard_ =
            contacts_->Greeted({robot_, pipeline::AgentKind::kSensor, host_}, std::move(said_));
      }
      admitted_ = true;
      outbound_->Resume();  // it pauses since its hello
      if (const auto left_out = logs_->Admit(robot_)) {
        LogInfo("sensor connected",
                {{"robot", robot_}, {"host", host_}, {"peer", address_}, {"left_out", *left_out}});
      }
    }
    SensorReply reply;
    rips::v1::SensorConfig* config = reply.mutable_config();
    config->set_linger_ms(setup.linger_ms);
    config->set_heartbeat_ms(setup.heartbeat_ms);
    config->set_batch_observations(setup.batch_observations);
    config->set_batch_bytes(setup.batch_bytes);
    config->set_primary(setup.primary);
    config->set_want_snapshot(setup.want_snapshot);
    config->set_want_findings(setup.want_findings);
    if (!setup.store.generation.empty()) {
      config->mutable_store()->set_generation(setup.store.generation);
      config->mutable_store()->set_commit(setup.store.commit);
    }
    for (const ros2::Guid& guid : setup.own_participants) {
      config->add_own_participants(guid.ToBytes());
    }
    for (const std::string& part : setup.protected_parts) config->add_protected_parts(part);
    *config->mutable_settings() = model_proto::Encode(setup.settings);
    outbound_->Send(std::move(reply));
  }
  void Acknowledge(const std::string& incarnation, Lane lane, uint64_t sequence,
                   uint64_t commit) override {
    SensorReply reply;
    reply.mutable_ack()->set_commit(commit);
    reply.mutable_ack()->set_incarnation(incarnation);
    reply.mutable_ack()->set_durable_sequence(sequence);
    reply.mutable_ack()->set_lane(lane == Lane::kControl ? rips::v1::CONTROL : rips::v1::MESSAGES);
    outbound_->Send(std::move(reply));
  }
  void Grant(uint64_t message_bytes, uint64_t payload_bytes) override {
    granted_ = message_bytes;
    payload_granted_ = payload_bytes;
    SensorReply reply;
    reply.mutable_credit()->set_message_bytes(message_bytes);
    reply.mutable_credit()->set_payload_bytes(payload_bytes);
    outbound_->Send(std::move(reply));
  }
  void Heartbeat(int64_t echo_boottime_ns) override {
    SensorReply reply;
    const Instant now = RealClock().Now();
    rips::v1::Heartbeat* heartbeat = reply.mutable_heartbeat();
    heartbeat->mutable_clock()->set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
    heartbeat->mutable_clock()->set_unix_ns(now.unix_ns);
    heartbeat->set_echo_boottime_ns(static_cast<uint64_t>(echo_boottime_ns));
    outbound_->Send(std::move(reply));
  }
  // Sent unless it is what the sensor has.
  std::string SetInterest(const engine::InterestPlan& plan, const engine::PayloadLimits& limits,
                          const ros2::TopicNames& kept_topics) override ABSL_LOCKS_EXCLUDED(mu_) {
    SensorReply reply;
    *reply.mutable_interest() = EncodeInterest(plan, limits, kept_topics);
    std::string id = reply.interest().id();
    {
      MutexLock lock(&mu_);
      if (interest_ == id) return id;
      interest_ = id;
    }
    outbound_->Send(std::move(reply));
    return id;
  }
  // The robot has taken the stream as a session. Any thread.
  bool admitted() const { return admitted_; }
  void Close(const absl::Status& status) override {
    if (const auto left_out = logs_->Admit(robot_)) {
      LogWarning(admitted_ ? "sensor stream closed" : "sensor refused",
                 {{"robot", robot_},
                  {"host", host_},
                  {"peer", address_},
                  {"reason", ros2::Printable(status.message())},
                  {"left_out", *left_out}});
    }
    outbound_->Close(rpc::ToGrpc(status));
  }
  // Bytes of message batches the peer may send in this stream.
  uint64_t granted() const { return granted_; }
  // And of payloads in chunks.
  uint64_t payload_granted() const { return payload_granted_; }

 private:
  std::shared_ptr<Stream::Outbound> outbound_;
  LogLimiter* logs_;
  std::string robot_;
  std::string host_;
  std::string address_;
  pipeline::AgentContacts::Greeting said_;  // until it is admitted
  // The robot's thread has taken it as a session, and written `heard_` before.
  std::atomic<bool> admitted_ = false;
  // Null of an agent that is not listed.
  std::shared_ptr<pipeline::AgentContacts::Heard> heard_;
  pipeline::AgentContacts* contacts_;  // may be null
  std::atomic<uint64_t> granted_ = 0;
  std::atomic<uint64_t> payload_granted_ = 0;
  Mutex mu_;
  // Id of the interest sent last, or found in use; empty = none.
  std::string interest_ ABSL_GUARDED_BY(mu_);
};

class SensorStream final : public Stream {
 public:
  SensorStream(const absl::StatusOr<rpc::Peer>& peer, grpc::CallbackServerContext* context,
               pipeline::Pipeline* pipeline, rpc::SessionWatch* watch, const IngestMetrics& metrics,
               pipeline::AgentContacts* contacts)
      : pipeline_(pipeline),
        watch_(watch),
        metrics_(metrics),
        link_(std::make_shared<Link>(outbound(), &pipeline->logs(), contacts)) {
    if (!peer.ok()) {
      outbound()->Close(rpc::ToGrpc(peer.status()));
    } else {
      mailbox_.emplace(pipeline, peer->identity.robot);
      host_ = peer->identity.host;
      address_ = context->peer();
      session_ = watch->Guard(rpc::StreamKind::kSensor, *peer, context, outbound());
      session_->connection = watch->gate().ConnectionOf(address_);
      metrics_.streams.Increment();
      Begin();
    }
  }

 private:
  bool OnBytes(size_t bytes, google::protobuf::io::ZeroCopyInputStream& encoded) override {
    watch_->Heard(*session_, bytes);
    link_->Heard(session_->heard_boottime_ns.load());
    if (refused_) return false;  // came before the peer heard of it
    const auto hit = wire_limits::CheckParsedSize(*SensorMessage::descriptor(), bytes, encoded);
    if (hit) RefuseField(*hit);
    return !hit.has_value();
  }

  void OnMessage(SensorMessage& message) override {
    if (const auto hit = wire_limits::Check(message)) return RefuseField(*hit);
    if (!session_->greeted && !message.has_hello()) {
      return Refuse(absl::InvalidArgumentError("the first message must be a hello"));
    }
    switch (message.kind_case()) {
      case SensorMessage::kHello:
        return OnHello(message.hello());
      case SensorMessage::kBatch:
        return OnBatch(message.batch());
      case SensorMessage::kHeartbeat:
        return Post(Lane::kControl, message.ByteSizeLong(),
                    [host = host_, link = link_, heartbeat = DecodeHeartbeat(message.heartbeat())](
                        Robot& robot) { robot.OnSensorHeartbeat(host, link.get(), heartbeat); });
      case SensorMessage::kInterestApplied:
        return OnInterestApplied(message.interest_applied());
      case SensorMessage::kChunk:
        return OnChunk(*message.mutable_chunk());
      case SensorMessage::KIND_NOT_SET:
        return;  // nothing this version asks for
    }
  }

  void OnHello(const rips::v1::SensorHello& hello) {
    if (session_->greeted.exchange(true)) {
      return Refuse(absl::InvalidArgumentError("a second hello in one stream"));
    }
    if (hello.hello().host() != host_) {
      return Refuse(watch_->gate().Refuse(
          {"claim",
           absl::PermissionDeniedError("the hello names another host than the certificate")},
          &session_->peer, address_));
    }
    absl::StatusOr<pipeline::SensorHello> decoded = DecodeHello(hello);
    if (!decoded.ok()) return Refuse(decoded.status());
    link_->SetPeer(mailbox_->robot(), host_, address_, hello);
    decoded->peer = address_;
    Post(Lane::kControl, hello.ByteSizeLong(),
         [host = host_, link = link_, hello = *std::move(decoded)](Robot& robot) {
           robot.OnSensorHello(host, link, hello);
         });
  }

  // A sensor that cannot apply an interest goes on with the one before.
  void OnInterestApplied(const rips::v1::InterestApplied& applied) {
    if (applied.interest().size() == kInterestIdBytes) {
      Post(Lane::kControl, applied.ByteSizeLong(),
           [host = host_, link = link_,
            answer =
                pipeline::InterestAnswer{.id = applied.interest(), .problem = applied.problem()}](
               Robot& robot) { robot.OnInterestAnswer(host, link.get(), answer); });
    }
    if (applied.problem().empty()) return;
    metrics_.interests_refused.Increment();
    const auto left_out = pipeline_->logs().Admit(mailbox_->robot());
    if (!left_out.has_value()) return;
    LogWarning("sensor cannot apply the interest", {{"robot", mailbox_->robot()},
                                                    {"host", host_},
                                                    {"problem", ros2::Printable(applied.problem())},
                                                    {"left_out", *left_out}});
  }

  // Held by the decoder until a batch names it; the credit bounds both together.
  void OnChunk(rips::v1::PayloadChunk& chunk) {
    payload_bytes_ += chunk.data().size();
    if (payload_bytes_ > link_->payload_granted()) {
      return Refuse(absl::ResourceExhaustedError(absl::StrCat(
          payload_bytes_, " bytes of payloads exceed the credit of ", link_->payload_granted())));
    }
    const absl::Status taken = decoder_.TakeChunk(chunk);
    if (!taken.ok()) Refuse(taken);
  }

  void OnBatch(const rips::v1::ObservationBatch& batch) {
    absl::StatusOr<pipeline::Batch> decoded = decoder_.Decode(batch);
    if (!decoded.ok()) return Refuse(decoded.status());
    const Lane lane = decoded->lane;
    if (lane == Lane::kMessages) message_bytes_ += decoded->bytes;
    if (message_bytes_ > link_->granted()) {
      return Refuse(absl::ResourceExhaustedError(absl::StrCat(
          message_bytes_, " bytes of messages exceed the credit of ", link_->granted())));
    }
    auto shared = std::make_shared<pipeline::Batch>(*std::move(decoded));
    Post(lane, shared->bytes + shared->payload_bytes,
         [host = host_, link = link_, shared](Robot& robot) {
           robot.OnBatch(host, link.get(), shared);
         });
  }

  void RefuseField(const wire_limits::LimitHit& hit) {
    metrics_.fields_refused.Count(hit);
    pipeline::TellRefusedField(*pipeline_, "sensor", mailbox_->robot(), host_, address_,
                               hit.Text());
    Refuse(hit.ToStatus());
  }

  void Refuse(const absl::Status& status) {
    refused_ = true;
    CountRefused(status);
    outbound()->Close(rpc::ToGrpc(status));
  }

  void CountRefused(const absl::Status& status) {
    // An agent of another version is no attacker.
    const bool hostile = !absl::IsFailedPrecondition(status);
    if (hostile && session_->connection != nullptr) session_->connection->OnRefused();
    metrics_.malformed.Increment();
    LogRefusal(status);
  }

  void LogRefusal(const absl::Status& status) {
    if (const auto left_out = pipeline_->logs().Admit(mailbox_->robot())) {
      LogWarning("sensor stream refused", {{"robot", mailbox_->robot()},
                                           {"host", host_},
                                           {"reason", status.ToString()},
                                           {"left_out", *left_out}});
    }
  }

  void Post(Lane lane, size_t bytes, std::function<void(Robot&)> task) {
    const absl::Status posted = mailbox_->Post(lane, bytes, std::move(task));
    if (posted.ok()) return;
    // A robot that is not in the inventory, or held.
    if (!std::exchange(refused_, true)) LogRefusal(posted);
    outbound()->Close(rpc::ToGrpc(posted));
  }

  bool OnRead(int64_t took_ns) override {
    return link_->admitted() &&
           pipeline::ReadsOn(watch_->OnRead(*session_, took_ns), metrics_.pauses, *pipeline_,
                             "sensor", mailbox_->robot(), host_, address_);
  }
  bool MayRead() override { return link_->admitted() && watch_->MayRead(*session_); }

  void OnUnreadable() override {
    if (session_ == nullptr || refused_) return;
    CountRefused(
        absl::InvalidArgumentError("a message cannot be decoded, or a half-closed stream"));
  }

  void OnEnded() override {
    if (!mailbox_) return;
    pipeline_
        ->Post(mailbox_->robot(), Lane::kControl,
               [host = host_, link = link_](Robot& robot) { robot.OnSensorGone(host, link.get()); })
        .IgnoreError();  // an overloaded or stopping shard notices the silence by itself
  }

  pipeline::Pipeline* pipeline_;
  rpc::SessionWatch* watch_;
  IngestMetrics metrics_;
  std::shared_ptr<Link> link_;
  std::shared_ptr<rpc::SessionWatch::Session> session_;
  std::optional<pipeline::Mailbox> mailbox_;
  std::string host_;
  std::string address_;
  ObservationDecoder decoder_;
  bool refused_ = false;
  uint64_t message_bytes_ = 0;
  uint64_t payload_bytes_ = 0;
};

}  // namespace

grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* SensorService::Observe(
    grpc::CallbackServerContext* context) {
  return new SensorStream(watch_->Admit(*context, rpc::Role::kSensor), context, pipeline_, watch_,
                          metrics_, contacts_);
}

}  // namespace rips::ingest
