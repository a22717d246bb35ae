#include "tests/bench/fleet_robot.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "absl/random/random.h"
#include "absl/strings/str_cat.h"
#include "services/runtime/real_clock.h"

namespace rips::bench {
namespace {

constexpr int64_t kSecondNs = 1'000'000'000;
// Of observations; the server takes no more (SensorConfig.batch_observations).
constexpr int kBatchMax = 256;
constexpr int kTopics = 10;
// Numbers of names on a stream: topics 1 to 10, then these, then writers of all topics.
constexpr int kProbeTopic = kTopics;
constexpr int kRaiseTopic = kTopics + 1;
constexpr int kAllTopics = kTopics + 2;
constexpr int kTypeId = kAllTopics + 1;
constexpr int kFirstWriterId = kTypeId + 1;
// Of the levels in the bench's bundle.
constexpr const char* kLevels[] = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"};

std::string TopicName(int topic) {
  if (topic == kProbeTopic) return "/probe";
  if (topic == kRaiseTopic) return "/raise";
  return absl::StrCat("/robot/topic_", topic);
}

size_t Rank(const std::string& level) {
  return static_cast<size_t>(std::find(std::begin(kLevels), std::end(kLevels), level) -
                             std::begin(kLevels));
}

std::string RandomBytes() {
  static Mutex mu;
  static absl::BitGen random;
  MutexLock lock(&mu);
  std::string bytes(16, '\0');
  for (char& byte : bytes) byte = static_cast<char>(absl::Uniform<int>(random, 0, 256));
  return bytes;
}

int64_t RandomBetween(int64_t least, int64_t most) {
  static Mutex mu;
  static absl::BitGen random;
  MutexLock lock(&mu);
  return absl::Uniform<int64_t>(random, least, most);
}

// Anew each time, so that robots do not come back at once.
int64_t Backoff() { return RandomBetween(kSecondNs / 5, 2 * kSecondNs); }

v1::Clock ClockNow() {
  const Instant now = RealClock().Now();
  v1::Clock clock;
  clock.set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  clock.set_unix_ns(now.unix_ns);
  return clock;
}

v1::Hello HelloOf(const std::string& incarnation) {
  v1::Hello hello;
  hello.set_protocol(1);
  hello.set_version("fleet_load");
  hello.set_incarnation(incarnation);
  hello.set_host("base");
  *hello.mutable_clock() = ClockNow();
  return hello;
}

// 16 bytes: of a participant, entity `entity`.
std::string GuidBytes(const std::string& incarnation, int entity, char kind) {
  std::string guid(16, '\0');
  guid[0] = 0x01;
  guid[1] = 0x10;
  incarnation.copy(&guid[2], 8);
  guid[13] = static_cast<char>(entity >> 8);
  guid[14] = static_cast<char>(entity);
  guid[15] = kind;
  return guid;
}

v1::Endpoint EndpointOf(const std::string& incarnation, int index, const std::string& topic) {
  v1::Endpoint endpoint;
  endpoint.set_guid(GuidBytes(incarnation, index + 2, '\x03'));
  endpoint.set_kind(v1::Endpoint::PUBLISHER);
  endpoint.set_name(topic);
  endpoint.set_type("std_msgs/msg/String");
  endpoint.set_node(absl::StrCat("/robot/node_", index));
  endpoint.set_ros(true);
  endpoint.set_visibility(v1::WATCHED);
  return endpoint;
}

v1::GraphSnapshot GraphOf(const std::string& incarnation, uint64_t version, int nodes) {
  v1::GraphSnapshot graph;
  graph.set_graph_version(version);
  graph.set_settled(true);
  const std::string participant = GuidBytes(incarnation, 1, '\xc1');
  graph.add_participants()->set_guid(participant);
  for (int i = 0; i < std::max(nodes, kAllTopics); ++i) {
    const std::string topic = i < kAllTopics ? TopicName(i) : absl::StrCat("/robot/other_", i);
    *graph.add_endpoints() = EndpointOf(incarnation, i, topic);
    v1::Node* node = graph.add_nodes();
    node->set_full_name(graph.endpoints(i).node());
    node->set_participant_guid(participant);
  }
  return graph;
}

grpc::Slice BytesOf(const v1::SensorMessage& message) {
  return grpc::Slice(message.SerializeAsString());
}

// Parts of one message may follow each other: the reader of Protocol Buffers merges them. So what
// all batches of a length share is made once.
grpc::Slice ObservationsOf(int count, int topic) {
  static Mutex mu;
  static std::map<std::pair<int, int>, grpc::Slice> made;
  MutexLock lock(&mu);
  const auto [it, fresh] = made.try_emplace({count, topic});
  if (!fresh) return it->second;
  v1::SensorMessage message;
  for (int i = 0; i < count; ++i) {
    const int of = topic == 0 ? i % kTopics : topic;
    v1::MessageSeen* seen = message.mutable_batch()->add_observations()->mutable_message();
    seen->set_topic_id(static_cast<uint32_t>(of + 1));
    seen->set_type_id(kTypeId);
    seen->set_writer_id(static_cast<uint32_t>(kFirstWriterId + of));
    seen->set_size_bytes(64);
  }
  it->second = BytesOf(message);
  return it->second;
}

grpc::Slice NamesOf(const std::string& incarnation) {
  v1::SensorMessage message;
  v1::ObservationBatch& batch = *message.mutable_batch();
  for (int topic = 0; topic < kAllTopics; ++topic) {
    v1::Intern* name = batch.add_interned();
    name->set_id(static_cast<uint32_t>(topic + 1));
    name->set_topic(TopicName(topic));
  }
  v1::Intern* type = batch.add_interned();
  type->set_id(kTypeId);
  type->set_type("std_msgs/msg/String");
  for (int topic = 0; topic < kAllTopics; ++topic) {
    v1::Intern* writer = batch.add_interned();
    writer->set_id(static_cast<uint32_t>(kFirstWriterId + topic));
    *writer->mutable_writer() = EndpointOf(incarnation, topic, TopicName(topic));
  }
  return BytesOf(message);
}

// A stream whose messages wait for each other. Under the robot's lock but for the On functions.
template <typename Request, typename Reply>
class Stream : public grpc::ClientBidiReactor<Request, Reply> {
 public:
  void Begin() {
    this->StartRead(&reply_);  // first: a call without operations may end within StartCall
    this->StartCall();
  }
  void Send(Request message) {
    waiting_.push_back(std::move(message));
    if (waiting_.size() == 1) this->StartWrite(&waiting_.front());
  }
  // Nothing is sent any more; the call ends soon.
  void Abandon() { abandoned_ = true; }
  void Cancel() { context_.TryCancel(); }
  bool abandoned() const { return abandoned_; }
  size_t waiting() const { return waiting_.size(); }
  grpc::ClientContext* context() { return &context_; }

 protected:
  void Written(bool ok) {
    waiting_.pop_front();
    if (ok && !abandoned_ && !waiting_.empty()) this->StartWrite(&waiting_.front());
  }
  Reply reply_;

 private:
  grpc::ClientContext context_;
  std::deque<Request> waiting_;
  bool abandoned_ = false;
};

}  // namespace

// ------------------------------------------------------------------------------------ latencies

void Latencies::Add(int64_t ns) {
  const double microseconds = std::max<double>(1, static_cast<double>(ns) / 1e3);
  const auto step = static_cast<size_t>(std::log(microseconds) / std::log(1.04));
  MutexLock lock(&mu_);
  ++steps_[std::min(step, steps_.size() - 1)];
  ++count_;
}

double Latencies::Percentile(double percent) const {
  MutexLock lock(&mu_);
  if (count_ == 0) return 0;
  const auto wanted = static_cast<uint64_t>(std::ceil(static_cast<double>(count_) * percent / 100));
  uint64_t seen = 0;
  for (size_t step = 0; step < steps_.size(); ++step) {
    seen += steps_[step];
    if (seen >= wanted) return std::pow(1.04, static_cast<double>(step + 1)) / 1e3;
  }
  return 0;
}

uint64_t Latencies::count() const {
  MutexLock lock(&mu_);
  return count_;
}

void Latencies::Clear() {
  MutexLock lock(&mu_);
  steps_ = {};
  count_ = 0;
}

// -------------------------------------------------------------------------------------- streams

class FleetRobot::SensorStream final : public Stream<grpc::ByteBuffer, v1::SensorReply> {
 public:
  explicit SensorStream(FleetRobot* robot) : robot_(*robot) {}
  void Say(const v1::SensorMessage& message) {
    const grpc::Slice bytes = BytesOf(message);
    Send(grpc::ByteBuffer(&bytes, 1));
  }
  void OnReadDone(bool ok) override {
    if (ok) {
      robot_.OnReply(reply_);
      return StartRead(&reply_);
    }
    MutexLock lock(&robot_.mu_);
    Abandon();
  }
  void OnWriteDone(bool ok) override {
    MutexLock lock(&robot_.mu_);
    Written(ok);
    if (ok && !abandoned()) robot_.SendWaiting();
  }
  void OnDone(const grpc::Status& status) override {
    robot_.OnSensorGone(status);
    delete this;
  }

 private:
  FleetRobot& robot_;
};

class FleetRobot::ActuatorStream final : public Stream<v1::ActuatorMessage, v1::ActuatorReply> {
 public:
  explicit ActuatorStream(FleetRobot* robot) : robot_(*robot) {}
  void OnReadDone(bool ok) override {
    if (ok) {
      robot_.OnReply(reply_);
      return StartRead(&reply_);
    }
    MutexLock lock(&robot_.mu_);
    Abandon();
  }
  void OnWriteDone(bool ok) override {
    MutexLock lock(&robot_.mu_);
    Written(ok);
  }
  void OnDone(const grpc::Status& status) override {
    robot_.OnActuatorGone(status);
    delete this;
  }

 private:
  FleetRobot& robot_;
};

// ---------------------------------------------------------------------------------------- robot

FleetRobot::FleetRobot(RobotPlan plan, std::shared_ptr<grpc::Channel> sensor,
                       std::shared_ptr<grpc::Channel> actuator, FleetLatencies* latencies)
    : plan_(std::move(plan)),
      sensor_stub_(std::move(sensor)),
      actuator_stub_(v1::ActuatorService::NewStub(std::move(actuator))),
      latencies_(*latencies),
      incarnation_(RandomBytes()) {}

FleetRobot::~FleetRobot() { End(); }

void FleetRobot::End() {
  MutexLock lock(&mu_);
  ended_ = true;
  if (sensor_ != nullptr) sensor_->Cancel();
  if (actuator_ != nullptr) actuator_->Cancel();
  while (sensor_ != nullptr || actuator_ != nullptr) gone_.Wait(lock);
}

void FleetRobot::Quiet() {
  MutexLock lock(&mu_);
  quiet_ = true;
}

RobotCounts FleetRobot::counts() const {
  MutexLock lock(&mu_);
  RobotCounts counts = counts_;
  counts.waiting = next_message_ - 1 - counts.acknowledged;
  counts.sent = next_message_ - 1;
  counts.connected = configured_ && actuator_ != nullptr && term_ > 0;
  counts.level = level_;
  return counts;
}

void FleetRobot::Step(int64_t now_ns) {
  MutexLock lock(&mu_);
  if (ended_) return;
  if (sensor_ == nullptr && now_ns >= sensor_due_ns_) ConnectSensor(now_ns);
  if (actuator_ == nullptr && now_ns >= actuator_due_ns_) ConnectActuator(now_ns);
  const int64_t passed_ns = stepped_ns_ == 0 ? kStepNs : now_ns - stepped_ns_;
  stepped_ns_ = now_ns;
  if (graph_version_ > 0 && !quiet_) {
    // Robots are not in step with each other, though they connected together.
    if (batch_due_ns_ == 0) batch_due_ns_ = now_ns + RandomBetween(0, linger_ns_ + 1);
    if (second_due_ns_ == 0) second_due_ns_ = now_ns + RandomBetween(0, kSecondNs);
    owed_ += plan_.rate * static_cast<double>(passed_ns) / 1e9;
    for (; owed_ >= kBatchMax; owed_ -= kBatchMax) MakeMessages(kBatchMax, 0, now_ns);
    if (now_ns >= batch_due_ns_) {
      batch_due_ns_ = now_ns + linger_ns_;
      const int count = static_cast<int>(owed_);
      owed_ -= count;
      MakeMessages(count, 0, now_ns);
    }
    if (plan_.raises && !std::exchange(raised_, true)) MakeMessages(1, kRaiseTopic, now_ns);
    if (now_ns >= second_due_ns_) {
      second_due_ns_ = now_ns + kSecondNs;
      if (plan_.probes && probe_at_ns_ == 0) {
        probe_at_ns_ = now_ns;
        MakeMessages(1, kProbeTopic, now_ns);
      }
      if (plan_.hostile) MakeGraph(now_ns);
    }
    while (plan_.hostile && messages_.size() < 64) MakeMessages(kBatchMax, 0, now_ns);
  }
  Heartbeats(now_ns);
  SendWaiting();
}

void FleetRobot::ConnectSensor(int64_t now_ns) {
  sensor_due_ns_ = now_ns + Backoff();
  sensor_interval_ns_ = model::kHeartbeatNs;
  configured_ = named_ = false;
  credit_bytes_ = used_bytes_ = 0;
  sent_batches_ = sent_control_ = 0;
  acks_due_ = 2;
  ++counts_.connects;
  sensor_ = new SensorStream(this);  // deletes itself
  sensor_stub_.PrepareBidiStreamingCall(sensor_->context(), "/rips.v1.SensorService/Observe", {},
                                        sensor_);
  v1::SensorMessage message;
  v1::SensorHello* hello = message.mutable_hello();
  *hello->mutable_hello() = HelloOf(incarnation_);
  const auto add = [&](v1::Lane lane, const std::deque<Sent>& unacknowledged, uint64_t next) {
    v1::SpoolStream* stream = hello->add_spooled();
    const uint64_t first = unacknowledged.empty() ? next : unacknowledged.front().first;
    stream->set_incarnation(incarnation_);
    stream->set_lane(lane);
    stream->set_first_sequence(first);
    stream->set_last_sequence(next - 1);
    stream->set_acknowledged_sequence(first - 1);
  };
  add(v1::CONTROL, control_, next_control_);
  add(v1::MESSAGES, messages_, next_message_);
  sensor_->Begin();
  sensor_->Say(message);
}

void FleetRobot::ConnectActuator(int64_t now_ns) {
  actuator_due_ns_ = now_ns + Backoff();
  actuator_interval_ns_ = model::kHeartbeatNs;
  actuator_ = new ActuatorStream(this);  // deletes itself
  actuator_stub_->async()->Attach(actuator_->context(), actuator_);
  v1::ActuatorMessage message;
  v1::ActuatorHello* hello = message.mutable_hello();
  *hello->mutable_hello() = HelloOf(incarnation_);
  for (const char* level : kLevels) hello->add_levels(level);
  hello->set_fail_safe_level("keep");
  hello->add_programs("note");
  *hello->mutable_decision_id() = decision_;
  hello->set_decided_level(level_);
  hello->set_effective_level(level_);
  hello->set_highest_term(term_);
  actuator_->Begin();
  actuator_->Send(std::move(message));
}

void FleetRobot::OnSensorGone(const grpc::Status& status) {
  MutexLock lock(&mu_);
  sensor_ = nullptr;
  configured_ = false;
  counts_.error = status.error_message();
  gone_.NotifyAll();
}

void FleetRobot::OnActuatorGone(const grpc::Status& status) {
  MutexLock lock(&mu_);
  actuator_ = nullptr;
  probe_at_ns_ = 0;  // its command may have gone with the stream
  counts_.error = status.error_message();
  gone_.NotifyAll();
}

void FleetRobot::OnReply(const v1::SensorReply& reply) {
  MutexLock lock(&mu_);
  const int64_t now_ns = RealClock().Now().boottime_ns;
  if (reply.has_config()) {
    want_snapshot_ = reply.config().want_snapshot();
    linger_ns_ = reply.config().linger_ms() * kNanosPerMilli;
    sensor_interval_ns_ = model::HeartbeatIntervalNs(reply.config().heartbeat_ms());
    configured_ = true;
  } else if (reply.has_credit()) {
    credit_bytes_ = reply.credit().message_bytes();
  } else if (reply.has_heartbeat()) {
    server_boottime_ns_ = reply.heartbeat().clock().boottime_ns();
  } else if (reply.has_interest()) {
    v1::SensorMessage message;
    message.mutable_interest_applied()->set_interest(reply.interest().id());
    if (!sensor_->abandoned()) sensor_->Say(message);
  } else if (reply.has_ack()) {
    acks_due_ = std::max(0, acks_due_ - 1);
    TakeAck(reply.ack());
    if (acks_due_ == 0 && std::exchange(want_snapshot_, false) && control_.empty()) {
      MakeGraph(now_ns);
    }
  }
  SendWaiting();
}

void FleetRobot::TakeAck(const v1::Ack& ack) {
  const bool of_control = ack.lane() == v1::CONTROL;
  std::deque<Sent>& unacknowledged = of_control ? control_ : messages_;
  size_t& sent = of_control ? sent_control_ : sent_batches_;
  const int64_t now_ns = RealClock().Now().boottime_ns;
  while (!unacknowledged.empty() && unacknowledged.front().last <= ack.durable_sequence()) {
    const Sent& front = unacknowledged.front();
    if (!of_control) {
      if (!plan_.hostile) latencies_.acknowledged.Add(now_ns - front.at_ns);
      counts_.acknowledged = front.last;
    }
    unacknowledged.pop_front();
    if (sent > 0) --sent;
  }
}

void FleetRobot::OnReply(const v1::ActuatorReply& reply) {
  MutexLock lock(&mu_);
  if (reply.has_lease()) {
    const v1::Lease& lease = reply.lease();
    lease_boottime_ns_ = lease.heartbeat().clock().boottime_ns();
    actuator_interval_ns_ = model::HeartbeatIntervalNs(lease.heartbeat_ms());
    term_ = std::max(term_, lease.term());
    if (Rank(lease.level()) < Rank(level_)) ++counts_.lowered;
  } else if (reply.has_command()) {
    TakeCommand(reply.command());
  }
}

void FleetRobot::HoldLevel(const std::string& level, const v1::DecisionId& decision) {
  if (Rank(level) < Rank(level_)) ++counts_.lowered;
  level_ = level;
  decision_ = decision;
}

void FleetRobot::TakeCommand(const v1::Command& command) {
  term_ = std::max(term_, command.term());
  if (command.has_run_program() && probe_at_ns_ != 0) {
    latencies_.command.Add(RealClock().Now().boottime_ns - std::exchange(probe_at_ns_, 0));
  }
  if (command.has_set_level()) {
    HoldLevel(command.set_level().to(), command.set_level().decision_id());
  }
  if (actuator_->abandoned()) return;
  for (const auto stage : {v1::Receipt::ACKNOWLEDGED, v1::Receipt::VERIFIED}) {
    v1::ActuatorMessage message;
    v1::Receipt* receipt = message.mutable_receipt();
    receipt->set_command_id(command.id());
    if (command.has_set_level()) *receipt->mutable_decision_id() = decision_;
    receipt->set_stage(stage);
    receipt->set_effective_level(level_);
    actuator_->Send(std::move(message));
  }
}

void FleetRobot::MakeMessages(int count, int topic, int64_t now_ns) {
  if (count == 0) return;
  v1::SensorMessage message;
  v1::ObservationBatch& batch = *message.mutable_batch();
  batch.set_incarnation(incarnation_);
  batch.set_first_sequence(next_message_);
  batch.set_lane(v1::MESSAGES);
  batch.set_base_boottime_ns(static_cast<uint64_t>(now_ns));
  batch.set_graph_version(graph_version_);
  const uint64_t first = next_message_;
  next_message_ += static_cast<uint64_t>(count);
  messages_.push_back({.bytes = {BytesOf(message), ObservationsOf(count, topic)},
                       .at_ns = now_ns,
                       .first = first,
                       .last = next_message_ - 1});
}

void FleetRobot::MakeGraph(int64_t now_ns) {
  v1::SensorMessage message;
  v1::ObservationBatch& batch = *message.mutable_batch();
  batch.set_incarnation(incarnation_);
  batch.set_first_sequence(next_control_);
  batch.set_lane(v1::CONTROL);
  batch.set_base_boottime_ns(static_cast<uint64_t>(now_ns));
  *batch.add_observations()->mutable_snapshot() =
      GraphOf(incarnation_, ++graph_version_, plan_.nodes);
  control_.push_back({.bytes = {BytesOf(message)},
                      .at_ns = now_ns,
                      .first = next_control_,
                      .last = next_control_});
  ++next_control_;
}

void FleetRobot::SendWaiting() {
  if (sensor_ == nullptr || sensor_->abandoned() || !configured_ || acks_due_ > 0) return;
  const auto send = [&](const std::vector<grpc::Slice>& bytes) {
    sensor_->Send(grpc::ByteBuffer(bytes.data(), bytes.size()));
  };
  for (; sent_control_ < control_.size() && sensor_->waiting() < 4; ++sent_control_) {
    send(control_[sent_control_].bytes);
  }
  if (sent_control_ < control_.size()) return;
  for (; sent_batches_ < messages_.size() && sensor_->waiting() < 4; ++sent_batches_) {
    std::vector<grpc::Slice> parts = messages_[sent_batches_].bytes;
    if (!named_) parts.insert(parts.begin(), NamesOf(incarnation_));
    uint64_t bytes = 0;  // the server counts a few less of each part
    for (const grpc::Slice& part : parts) bytes += part.size();
    if (used_bytes_ + bytes > credit_bytes_) return;
    named_ = true;
    used_bytes_ += bytes;
    send(parts);
  }
}

void FleetRobot::Heartbeats(int64_t now_ns) {
  const bool sensor_due = now_ns >= sensor_heartbeat_ns_ + sensor_interval_ns_;
  if (sensor_due && sensor_ != nullptr && !sensor_->abandoned()) {
    sensor_heartbeat_ns_ = now_ns;
    v1::SensorMessage message;
    *message.mutable_heartbeat()->mutable_clock() = ClockNow();
    message.mutable_heartbeat()->set_echo_boottime_ns(server_boottime_ns_);
    sensor_->Say(message);
  }
  const bool actuator_due = now_ns >= actuator_heartbeat_ns_ + actuator_interval_ns_;
  if (actuator_due && actuator_ != nullptr && !actuator_->abandoned()) {
    actuator_heartbeat_ns_ = now_ns;
    v1::ActuatorMessage message;
    v1::ActuatorHeartbeat* heartbeat = message.mutable_heartbeat();
    *heartbeat->mutable_heartbeat()->mutable_clock() = ClockNow();
    heartbeat->mutable_heartbeat()->set_echo_boottime_ns(lease_boottime_ns_);
    heartbeat->set_effective_level(level_);
    heartbeat->set_verified(true);
    actuator_->Send(std::move(message));
  }
}

}  // namespace rips::bench
