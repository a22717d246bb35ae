#include "policy_server/server/dispatch/actuator_service.h"

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "policy_server/server/shard/agent_alerts.h"
#include "policy_server/server/shard/mailbox.h"
#include "services/model_proto/actuator_codec.h"
#include "services/model_proto/configuration_codec.h"
#include "services/ros2/ros_name.h"
#include "services/rpc/peer.h"
#include "services/rpc/peer_address.h"
#include "services/rpc/server_stream.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/wire_limits/field_limits.h"
#include "services/wire_limits/parsed_size.h"

namespace rips::dispatch {
namespace {

using pipeline::Queue;
using pipeline::Robot;
using rips::v1::ActuatorMessage;
using rips::v1::ActuatorReply;
using Stream = rpc::ServerStream<ActuatorMessage, ActuatorReply>;

// What the pipeline holds of one stream.
class Link final : public pipeline::ActuatorLink {
 public:
  Link(std::shared_ptr<Stream::Outbound> outbound, Counter commands, LogLimiter* logs,
       std::function<model::AuditHead()> newest_head, pipeline::AgentContacts* contacts)
      : outbound_(std::move(outbound)),
        commands_(commands),
        logs_(logs),
        contacts_(contacts),
        newest_head_(std::move(newest_head)) {}

  // Once, before the hello is posted.
  void SetPeer(std::string robot, std::string host, std::string address,
               const rips::v1::Hello& hello) {
    robot_ = std::move(robot);
    host_ = std::move(host);
    address_ = std::move(address);
    said_ = {.version = hello.version(), .address = rpc::AddressOfPeer(address_)};
    if (hello.has_configuration()) {
      said_.configuration = model_proto::Bounded(hello.configuration()).SerializeAsString();
    }
  }
  // A message has come. Noted of an agent that was admitted: what others say with its key counts
  // for nothing.
  void Heard(int64_t boottime_ns) {
    if (admitted_ && heard_ != nullptr) *heard_ = boottime_ns;
  }

  void Grant(const pipeline::LeaseGrant& lease) override {
    if (!admitted_) {
      if (contacts_ != nullptr) {
        heard_ =
            contacts_->Greeted({robot_, pipeline::AgentKind::kActuator, host_}, std::move(said_));
      }
      admitted_ = true;
      outbound_->Resume();  // it pauses since its hello
      if (const auto left_out = logs_->Admit(robot_)) {
        LogInfo("actuator connected",
                {{"robot", robot_}, {"host", host_}, {"peer", address_}, {"left_out", *left_out}});
      }
    }
    ActuatorReply reply;
    pipeline::LeaseGrant granted = lease;
    if (newest_head_) granted.audit_head = newest_head_();
    *reply.mutable_lease() = model_proto::Encode(granted, RealClock().Now());
    outbound_->Send(std::move(reply));
  }
  void Send(const pipeline::Command& command) override {
    ActuatorReply reply;
    *reply.mutable_command() = model_proto::Encode(command);
    outbound_->Send(std::move(reply));
    commands_.Increment();
  }
  // The robot has taken the stream as a session. Any thread.
  bool admitted() const { return admitted_; }
  void Close(const absl::Status& status) override {
    if (const auto left_out = logs_->Admit(robot_)) {
      LogWarning(admitted_ ? "actuator stream closed" : "actuator refused",
                 {{"robot", robot_},
                  {"host", host_},
                  {"peer", address_},
                  {"reason", ros2::Printable(status.message())},
                  {"left_out", *left_out}});
    }
    outbound_->Close(rpc::ToGrpc(status));
  }

 private:
  std::shared_ptr<Stream::Outbound> outbound_;
  std::string robot_;
  std::string host_;
  std::string address_;
  pipeline::AgentContacts::Greeting said_;  // until it is admitted
  // The robot's thread has taken it as a session, and written `heard_` before.
  std::atomic<bool> admitted_ = false;
  // Null of an agent that is not listed.
  std::shared_ptr<pipeline::AgentContacts::Heard> heard_;
  Counter commands_;
  LogLimiter* logs_;
  pipeline::AgentContacts* contacts_;  // may be null
  // Robots may hold links for longer than the service lives.
  const std::function<model::AuditHead()> newest_head_;
};

class ActuatorStream final : public Stream {
 public:
  ActuatorStream(const absl::StatusOr<rpc::Peer>& peer, grpc::CallbackServerContext* context,
                 pipeline::Pipeline* pipeline, rpc::SessionWatch* watch,
                 const DispatchMetrics& metrics, const AuditHeads* heads,
                 pipeline::AgentContacts* contacts)
      : pipeline_(pipeline),
        watch_(watch),
        metrics_(metrics),
        heads_(heads),
        link_(std::make_shared<Link>(outbound(), metrics.commands, &pipeline->logs(), heads->newest,
                                     contacts)) {
    if (!peer.ok()) {
      outbound()->Close(rpc::ToGrpc(peer.status()));
    } else {
      mailbox_.emplace(pipeline, peer->identity.robot);
      host_ = peer->identity.host;
      address_ = context->peer();
      session_ = watch->Guard(rpc::StreamKind::kActuator, *peer, context, outbound());
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
    const auto hit = wire_limits::CheckParsedSize(*ActuatorMessage::descriptor(), bytes, encoded);
    if (hit) RefuseField(*hit);
    return !hit.has_value();
  }

  void OnMessage(ActuatorMessage& message) override {
    if (const auto hit = wire_limits::Check(message)) return RefuseField(*hit);
    if (!session_->greeted && !message.has_hello()) {
      return Refuse(absl::InvalidArgumentError("the first message must be a hello"));
    }
    switch (message.kind_case()) {
      case ActuatorMessage::kHello:
        return OnHello(message.hello());
      case ActuatorMessage::kReceipt:
        return OnReceipt(message.receipt());
      case ActuatorMessage::kHeartbeat:
        return Post(
            message.ByteSizeLong(),
            [host = host_, link = link_, heartbeat = model_proto::Decode(message.heartbeat())](
                Robot& robot) { robot.OnActuatorHeartbeat(host, link.get(), heartbeat); });
      case ActuatorMessage::KIND_NOT_SET:
        return;  // a newer actuator's kind
    }
  }

  void OnHello(const rips::v1::ActuatorHello& hello) {
    if (session_->greeted.exchange(true)) {
      return Refuse(absl::InvalidArgumentError("a second hello in one stream"));
    }
    if (hello.hello().host() != host_) {
      return Refuse(watch_->gate().Refuse(
          {"claim",
           absl::PermissionDeniedError("the hello names another host than the certificate")},
          &session_->peer, address_));
    }
    absl::StatusOr<pipeline::ActuatorHello> decoded = model_proto::Decode(hello);
    if (!decoded.ok()) return Refuse(decoded.status());
    link_->SetPeer(mailbox_->robot(), host_, address_, hello.hello());
    decoded->peer = address_;
    model::AuditHead head = decoded->last_audit_head;
    Post(hello.ByteSizeLong(), [host = host_, link = link_, hello = *std::move(decoded)](
                                   Robot& robot) { robot.OnActuatorHello(host, link, hello); });
    // Posted: the robot, though perhaps not the host, is one of the inventory.
    if (!refused_ && heads_->returned) {
      heads_->returned(mailbox_->robot(), host_, std::move(head));
    }
  }

  void OnReceipt(const rips::v1::Receipt& receipt) {
    absl::StatusOr<pipeline::Receipt> decoded = model_proto::Decode(receipt);
    if (!decoded.ok()) return Refuse(decoded.status());
    Post(receipt.ByteSizeLong(), [host = host_, link = link_, receipt = *std::move(decoded)](
                                     Robot& robot) { robot.OnReceipt(host, link.get(), receipt); });
  }

  void RefuseField(const wire_limits::LimitHit& hit) {
    metrics_.fields_refused.Count(hit);
    pipeline::TellRefusedField(*pipeline_, "actuator", mailbox_->robot(), host_, address_,
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
      LogWarning("actuator stream refused", {{"robot", mailbox_->robot()},
                                             {"host", host_},
                                             {"reason", status.ToString()},
                                             {"left_out", *left_out}});
    }
  }

  void Post(size_t bytes, std::function<void(Robot&)> task) {
    const absl::Status posted = mailbox_->Post(Queue::kActuators, bytes, std::move(task));
    if (posted.ok()) return;
    // A robot that is not in the inventory, or held.
    if (!std::exchange(refused_, true)) LogRefusal(posted);
    outbound()->Close(rpc::ToGrpc(posted));
  }

  bool OnRead(int64_t took_ns) override {
    return link_->admitted() &&
           pipeline::ReadsOn(watch_->OnRead(*session_, took_ns), metrics_.pauses, *pipeline_,
                             "actuator", mailbox_->robot(), host_, address_);
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
        ->Post(
            mailbox_->robot(), Queue::kActuators,
            [host = host_, link = link_](Robot& robot) { robot.OnActuatorGone(host, link.get()); })
        .IgnoreError();  // an overloaded or stopping shard notices the silence by itself
  }

  pipeline::Pipeline* pipeline_;
  rpc::SessionWatch* watch_;
  DispatchMetrics metrics_;
  const AuditHeads* heads_;
  std::shared_ptr<Link> link_;
  std::shared_ptr<rpc::SessionWatch::Session> session_;
  std::optional<pipeline::Mailbox> mailbox_;
  std::string host_;
  std::string address_;
  bool refused_ = false;
};

}  // namespace

grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* ActuatorService::Attach(
    grpc::CallbackServerContext* context) {
  return new ActuatorStream(watch_->Admit(*context, rpc::Role::kActuator), context, pipeline_,
                            watch_, metrics_, &heads_, contacts_);
}

}  // namespace rips::dispatch
