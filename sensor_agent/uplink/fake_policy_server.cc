#include "sensor_agent/uplink/fake_policy_server.h"

#include <algorithm>
#include <chrono>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "grpcpp/server_builder.h"
#include "services/wire_limits/field_limits.h"

namespace rips::sensor {

namespace {

using rips::v1::SensorMessage;
using rips::v1::SensorReply;

ros2::Guid ToGuid(const std::string& bytes) {
  const auto guid = ros2::GuidFromBytes(bytes);
  return guid.ok() ? *guid : ros2::Guid{};
}

ros2::Endpoint ToEndpoint(const rips::v1::Endpoint& wire) {
  ros2::Endpoint endpoint{.guid = ToGuid(wire.guid()),
                          .name = wire.name(),
                          .type = wire.type(),
                          .node = wire.node(),
                          .pending = wire.pending(),
                          .why = wire.why(),
                          .ros = wire.ros()};
  switch (wire.kind()) {
    case rips::v1::Endpoint::SUBSCRIBER:
      endpoint.kind = ros2::EndpointKind::kSubscriber;
      break;
    case rips::v1::Endpoint::SERVICE:
      endpoint.kind = ros2::EndpointKind::kService;
      break;
    case rips::v1::Endpoint::CLIENT:
      endpoint.kind = ros2::EndpointKind::kClient;
      break;
    default:
      break;
  }
  switch (wire.visibility()) {
    case rips::v1::WATCHED:
      endpoint.visibility = ros2::Visibility::kWatched;
      break;
    case rips::v1::NOT_NEEDED:
      endpoint.visibility = ros2::Visibility::kNotNeeded;
      break;
    case rips::v1::NOT_VISIBLE:
      endpoint.visibility = ros2::Visibility::kNotVisible;
      break;
    default:
      break;
  }
  return endpoint;
}

template <typename Participants, typename Nodes, typename Endpoints>
ros2::GraphDelta ToDelta(const Participants& participants, const Nodes& nodes,
                         const Endpoints& endpoints) {
  ros2::GraphDelta delta;
  for (const auto& each : participants) {
    delta.upsert_participants.push_back({.guid = ToGuid(each.guid()),
                                         .host = each.host(),
                                         .enclave = each.enclave(),
                                         .pid = each.pid(),
                                         .vendor = each.vendor(),
                                         .authenticated = each.authenticated()});
  }
  for (const auto& each : nodes) {
    delta.upsert_nodes.push_back({each.full_name(), ToGuid(each.participant_guid())});
  }
  for (const auto& each : endpoints) delta.upsert_endpoints.push_back(ToEndpoint(each));
  return delta;
}

}  // namespace

void FakePolicyServer::Start(std::shared_ptr<grpc::ServerCredentials> credentials) {
  {
    MutexLock lock(&mu_);
    stopping_ = false;
  }
  grpc::ServerBuilder builder;
  builder.AddListeningPort(absl::StrCat("127.0.0.1:", port_), credentials, &port_);
  builder.RegisterService(this);
  server_ = builder.BuildAndStart();
}

void FakePolicyServer::Stop() {
  if (server_ == nullptr) return;
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    for (grpc::ServerContext* context : contexts_) context->TryCancel();
  }
  server_->Shutdown(std::chrono::system_clock::now() + std::chrono::seconds(1));
  server_.reset();
}

std::string FakePolicyServer::address() const { return absl::StrCat("127.0.0.1:", port_); }

void FakePolicyServer::Set(const std::function<void(Behaviour&)>& change) {
  MutexLock lock(&mu_);
  change(behaviour_);
}

bool FakePolicyServer::WaitUntil(const std::function<bool(const FakePolicyServer&)>& done) const {
  const absl::Time deadline = absl::Now() + absl::Seconds(60);
  while (absl::Now() < deadline) {
    {
      MutexLock lock(&mu_);
      if (done(*this)) return true;
    }
    absl::SleepFor(absl::Milliseconds(2));
  }
  return false;
}

std::vector<Recorded> FakePolicyServer::Distinct(rips::v1::Lane lane) const {
  std::map<std::pair<std::string, uint64_t>, Recorded> distinct;
  for (const Recorded& each : received) {
    if (each.lane == lane) distinct[{each.incarnation, each.sequence}] = each;
  }
  std::vector<Recorded> all;
  for (auto& [key, each] : distinct) all.push_back(std::move(each));
  return all;
}

SensorReply FakePolicyServer::AckLocked(const LaneKey& key) {
  SensorReply reply;
  reply.mutable_ack()->set_incarnation(key.first);
  reply.mutable_ack()->set_lane(key.second);
  reply.mutable_ack()->set_durable_sequence(judged_[key]);
  reply.mutable_ack()->set_commit(behaviour_.commit);
  return reply;
}

void FakePolicyServer::Send(const SensorReply& reply) {
  MutexLock lock(&mu_);
  payload_granted_ = std::max(payload_granted_, reply.credit().payload_bytes());
  if (stream_ != nullptr) stream_->Write(reply);
}

void FakePolicyServer::AnswerHello(const rips::v1::SensorHello& hello, Stream* stream) {
  MutexLock lock(&mu_);
  hellos.push_back(hello);
  if (behaviour_.silent) return;
  if (behaviour_.forget) {
    graph_incarnation_.clear();
    judged_.clear();
    behaviour_.forget = false;
  }
  SensorReply config;
  config.mutable_config()->set_linger_ms(5);
  config.mutable_config()->set_batch_observations(16);
  config.mutable_config()->set_batch_bytes(32 * 1024);
  const std::string& primary = behaviour_.primary_host;
  config.mutable_config()->set_primary(behaviour_.primary &&
                                       (primary.empty() || primary == hello.hello().host()));
  config.mutable_config()->set_want_snapshot(behaviour_.ask_for_snapshot &&
                                             graph_incarnation_ != hello.hello().incarnation());
  if (!behaviour_.generation.empty()) {
    config.mutable_config()->mutable_store()->set_generation(behaviour_.generation);
    config.mutable_config()->mutable_store()->set_commit(behaviour_.commit);
  }
  for (const std::string& guid : behaviour_.own_participants) {
    config.mutable_config()->add_own_participants(guid);
  }
  for (const std::string& part : behaviour_.protected_parts) {
    config.mutable_config()->add_protected_parts(part);
  }
  stream->Write(config);
  SensorReply credit;
  credit.mutable_credit()->set_message_bytes(behaviour_.credit);
  credit.mutable_credit()->set_payload_bytes(behaviour_.payload_credit);
  payload_granted_ = behaviour_.payload_credit;
  stream->Write(credit);
  for (const auto& spooled : hello.spooled()) {
    const LaneKey key(spooled.incarnation(), spooled.lane());
    // What the sensor does not hold any more will never come.
    judged_[key] = std::max(judged_[key], spooled.first_sequence() - 1);
    SensorReply ack = AckLocked(key);
    if (behaviour_.acknowledge_zero_once) ack.mutable_ack()->set_durable_sequence(0);
    stream->Write(ack);
  }
  behaviour_.acknowledge_zero_once = false;
  stream_ = stream;
}

void FakePolicyServer::TakeGraph(const std::string& incarnation,
                                 const rips::v1::Observation& observation) {
  absl::Status applied;
  if (observation.has_snapshot()) {
    const auto& snapshot = observation.snapshot();
    ros2::RosGraph fresh;
    applied = fresh.Apply(ToDelta(snapshot.participants(), snapshot.nodes(), snapshot.endpoints()));
    graph = fresh;
    graph_version = snapshot.graph_version();
    settled = snapshot.settled();
    graph_incarnation_ = incarnation;
  } else {
    const auto& delta = observation.delta();
    if (graph_incarnation_.empty() || delta.to_version() <= graph_version) return;
    if (delta.from_version() != graph_version) {
      violations.push_back(
          absl::StrCat("delta from ", delta.from_version(), ", held is ", graph_version));
    }
    ros2::GraphDelta change =
        ToDelta(delta.upsert_participants(), delta.upsert_nodes(), delta.upsert_endpoints());
    for (const std::string& guid : delta.gone_guids()) change.gone_guids.push_back(ToGuid(guid));
    change.gone_nodes.assign(delta.gone_nodes().begin(), delta.gone_nodes().end());
    applied = graph.Apply(change);
    graph_version = delta.to_version();
    settled = delta.settled();
  }
  if (!applied.ok()) violations.push_back(applied.ToString());
}

void FakePolicyServer::TakeChunk(const rips::v1::PayloadChunk& chunk, Names& names) {
  const uint64_t id = chunk.chunked_payload_id();
  if (id == names.last_payload + 1) names.payloads[++names.last_payload];
  std::string& payload = names.payloads[id];
  if (id != names.last_payload || chunk.offset() != payload.size() || chunk.data().empty() ||
      chunk.data().size() > 65'536 || payload.size() % 65'536 != 0) {
    violations.push_back(absl::StrCat("chunk of ", chunk.data().size(), " bytes at ",
                                      chunk.offset(), " of payload ", id, " after ", payload.size(),
                                      " of ", names.last_payload));
  }
  payload += chunk.data();
  names.payload_bytes += chunk.data().size();
  chunk_bytes += chunk.data().size();
  ++chunks;
  order += 'c';
}

void FakePolicyServer::Assemble(rips::v1::ObservationBatch& batch, Names& names) {
  uint64_t last = 0;
  for (auto& each : *batch.mutable_observations()) {
    const uint64_t id = each.message().chunked_payload_id();
    if (id == 0) continue;
    if (id <= last || !names.payloads.contains(id) || !each.message().payload().empty()) {
      violations.push_back(absl::StrCat("a message names payload ", id));
    }
    last = id;
    each.mutable_message()->set_payload(names.payloads[id]);
  }
  if (batch.lane() == rips::v1::MESSAGES) names.payloads.clear();
}

void FakePolicyServer::TakeBatch(const rips::v1::ObservationBatch& batch, Names& names) {
  for (const auto& intern : batch.interned()) {
    if (intern.id() == 0 || !names.by_id.emplace(intern.id(), intern).second) {
      violations.push_back(absl::StrCat("name ", intern.id(), " twice"));
    }
  }
  const LaneKey key(batch.incarnation(), batch.lane());
  uint64_t& judged = judged_[key];
  if (batch.first_sequence() > judged + 1 || batch.observations_size() == 0) {
    violations.push_back(absl::StrCat("lane ", batch.lane(), ": batch at ", batch.first_sequence(),
                                      " after ", judged));
  }
  size_t payload_bytes = 0;
  for (const auto& each : batch.observations()) {
    const rips::v1::MessageSeen& message = each.message();
    const bool chunked = message.chunked_payload_id() != 0;
    if (!chunked) payload_bytes += message.payload().size();
    if (message.payload().size() > message.size_bytes() ||
        chunked != (message.payload().size() > 65'536) ||
        message.truncated() != (message.payload().size() < message.size_bytes())) {
      violations.push_back(absl::StrCat("payload of ", message.payload().size(), " bytes of ",
                                        message.size_bytes(), ", truncated ", message.truncated()));
    }
  }
  if (payload_bytes > 1 << 20) violations.push_back(absl::StrCat(payload_bytes, " payload bytes"));
  for (int i = 0; i < batch.observations_size(); ++i) {
    const auto& what = batch.observations(i);
    Recorded one{.incarnation = batch.incarnation(),
                 .lane = batch.lane(),
                 .sequence = batch.first_sequence() + static_cast<uint64_t>(i),
                 .what = what};
    if (what.has_message()) {
      one.topic = names.by_id[what.message().topic_id()].topic();
      one.type = names.by_id[what.message().type_id()].type();
      one.writer = names.by_id[what.message().writer_id()].writer();
    } else if (what.has_loss()) {
      one.topic = names.by_id[what.loss().topic_id()].topic();
    }
    if (one.sequence > judged) {
      judged = one.sequence;
      if (what.has_snapshot() || what.has_delta()) TakeGraph(one.incarnation, what);
    }
    received.push_back(std::move(one));
  }
}

grpc::Status FakePolicyServer::Observe(grpc::ServerContext* context, Stream* stream) {
  {
    MutexLock lock(&mu_);
    if (stopping_) return grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping");
    contexts_.insert(context);
  }
  grpc::Status status;
  Names names;
  SensorMessage message;
  bool greeted = false;
  while (stream->Read(&message)) {
    if (const auto hit = wire_limits::Check(message)) {
      MutexLock lock(&mu_);
      violations.push_back(hit->Text());
    }
    if (message.has_hello()) {
      if (std::exchange(greeted, true)) status = {grpc::StatusCode::INVALID_ARGUMENT, "twice"};
      AnswerHello(message.hello(), stream);
      continue;
    }
    MutexLock lock(&mu_);
    if (!greeted) violations.push_back("the first message is no hello");
    if (message.has_heartbeat()) {
      ++heartbeats;
      SensorReply heartbeat;
      heartbeat.mutable_heartbeat()->mutable_clock()->set_boottime_ns(12'345);
      heartbeat.mutable_heartbeat()->set_echo_boottime_ns(
          message.heartbeat().clock().boottime_ns());
      if (!behaviour_.silent) stream->Write(heartbeat);
    }
    if (message.has_interest_applied()) interests_applied.push_back(message.interest_applied());
    if (message.has_chunk()) {
      TakeChunk(message.chunk(), names);
      if (names.payload_bytes > payload_granted_) violations.push_back("payload credit");
      if (behaviour_.chunks_until_close > 0 && --behaviour_.chunks_until_close == 0) {
        status = behaviour_.close_with;
        break;
      }
    }
    if (!message.has_batch()) continue;
    if (behaviour_.silent) violations.push_back("a batch before the resume was answered");
    const bool messages = message.batch().lane() == rips::v1::MESSAGES;
    order += messages ? 'm' : 'l';
    if (messages) names.message_bytes += message.batch().ByteSizeLong();
    Assemble(*message.mutable_batch(), names);
    batches.push_back(message.batch());
    const bool close = behaviour_.batches_until_close == 1;
    if (behaviour_.batches_until_close > 0) --behaviour_.batches_until_close;
    const bool refuse =
        close && behaviour_.close_with.error_code() == grpc::StatusCode::INVALID_ARGUMENT;
    if (!refuse) TakeBatch(message.batch(), names);
    if (close) {
      status = behaviour_.close_with;
      break;
    }
    if (behaviour_.renew_credit && messages) {
      SensorReply credit;
      credit.mutable_credit()->set_message_bytes(names.message_bytes + behaviour_.credit);
      payload_granted_ = names.payload_bytes + behaviour_.payload_credit;
      credit.mutable_credit()->set_payload_bytes(payload_granted_);
      stream->Write(credit);
    }
    if (behaviour_.acknowledge) {
      stream->Write(AckLocked({message.batch().incarnation(), message.batch().lane()}));
    }
  }
  MutexLock lock(&mu_);
  if (stream_ == stream) stream_ = nullptr;
  contexts_.erase(context);
  return status;
}

}  // namespace rips::sensor
