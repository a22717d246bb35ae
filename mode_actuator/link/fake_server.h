// A policy server for tests of the actuator's agent.
#ifndef RIPS_MODE_ACTUATOR_LINK_FAKE_SERVER_H_
#define RIPS_MODE_ACTUATOR_LINK_FAKE_SERVER_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "rips/v1/actuator.grpc.pb.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"
#include "services/base/status_matchers.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/mutex.h"
#include "services/wire_limits/field_limits.h"

namespace rips::actuator {

// Keeps what actuators say; says what the test pushes.
class FakeServer final : public v1::ActuatorService::Service {
 public:
  using Stream = grpc::ServerReaderWriter<v1::ActuatorReply, v1::ActuatorMessage>;

  explicit FakeServer(const TlsFiles& tls, int port = 0) {
    auto credentials = rpc::Credentials::Load(tls);
    EXPECT_THAT(credentials, IsOk());
    auto server = rpc::RpcServer::Start(
        {.listen = absl::StrCat("127.0.0.1:", port), .credentials = (*credentials)->ForServer()},
        {this});
    EXPECT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  ~FakeServer() override {
    {
      MutexLock lock(&mu_);
      closing_ = true;
      changed_.NotifyAll();
    }
    server_->Shutdown(absl::ZeroDuration());
  }

  grpc::Status Attach(grpc::ServerContext* context, Stream* stream) override {
    std::thread writer([&] {
      while (std::optional<v1::ActuatorReply> reply = NextReply(context)) {
        if (!stream->Write(*reply)) return;
      }
    });
    for (v1::ActuatorMessage message; stream->Read(&message);) {
      if (const auto hit = wire_limits::Check(message)) ADD_FAILURE() << hit->Text();
      MutexLock lock(&mu_);
      if (message.has_hello()) {
        hellos_.push_back(message.hello());
      } else if (message.has_receipt()) {
        receipts_.push_back(message.receipt());
        overtook_ += message.receipt().stage() == v1::Receipt::VERIFIED &&
                             message.receipt().effective_level() != heartbeat_.effective_level()
                         ? 1
                         : 0;
      } else if (message.has_heartbeat()) {
        heartbeat_ = message.heartbeat();
        sent_ms_.push_back(heartbeat_.heartbeat().clock().boottime_ns() / kNanosPerMilli);
        if (leases_) replies_.push_back(LeaseLocked());
      }
      changed_.NotifyAll();
    }
    {
      MutexLock lock(&mu_);
      ended_ = context;
      changed_.NotifyAll();
    }
    writer.join();
    MutexLock lock(&mu_);
    if (ended_ == context) ended_ = nullptr;  // the next stream's may be at the same address
    return grpc::Status::OK;
  }

  void Push(v1::ActuatorReply reply) {
    MutexLock lock(&mu_);
    replies_.push_back(std::move(reply));
    changed_.NotifyAll();
  }
  void SetLevel(const std::string& id, const std::string& to, DecisionId decision_id,
                std::optional<DecisionId> based_on = std::nullopt, uint64_t term = 1) {
    v1::ActuatorReply reply;
    v1::Command* command = reply.mutable_command();
    command->set_id(id);
    command->set_term(term);
    command->mutable_set_level()->set_to(to);
    command->mutable_set_level()->mutable_decision_id()->set_term(decision_id.term);
    command->mutable_set_level()->mutable_decision_id()->set_epoch(decision_id.epoch);
    if (based_on.has_value()) {
      command->mutable_set_level()->mutable_based_on()->set_term(based_on->term);
      command->mutable_set_level()->mutable_based_on()->set_epoch(based_on->epoch);
    }
    Push(std::move(reply));
  }
  void Run(const std::string& id, const std::string& program, std::vector<std::string> args) {
    v1::ActuatorReply reply;
    v1::Command* command = reply.mutable_command();
    command->set_id(id);
    command->set_term(1);
    command->mutable_run_program()->set_program(program);
    for (const std::string& arg : args) command->mutable_run_program()->add_args(arg);
    Push(std::move(reply));
  }

  void Drill(const std::string& id, const std::string& level, uint64_t term = 1) {
    v1::ActuatorReply reply;
    v1::Command* command = reply.mutable_command();
    command->set_id(id);
    command->set_term(term);
    command->mutable_drill()->set_level(level);
    Push(std::move(reply));
  }

  // True as soon as `condition` holds, which sees everything received; false after 20 s.
  bool Until(const std::function<bool()>& condition) ABSL_NO_THREAD_SAFETY_ANALYSIS {
    MutexLock lock(&mu_);
    for (int i = 0; i < 200 && !condition(); ++i) {
      changed_.WaitFor(lock, absl::Milliseconds(100));
    }
    return condition();
  }
  // The newest receipt of a command.
  bool HasReceipt(const std::string& id, v1::Receipt::Stage stage) {
    return Until([&] {
      for (const v1::Receipt& receipt : receipts_) {
        if (receipt.command_id() == id && receipt.stage() == stage) return true;
      }
      return false;
    });
  }
  v1::Receipt Last(const std::string& id) {
    MutexLock lock(&mu_);
    for (auto it = receipts_.rbegin(); it != receipts_.rend(); ++it) {
      if (it->command_id() == id) return *it;
    }
    return {};
  }
  std::vector<v1::Receipt> Receipts() {
    MutexLock lock(&mu_);
    return receipts_;
  }
  v1::ActuatorHello Hello(size_t index) {
    MutexLock lock(&mu_);
    return index < hellos_.size() ? hellos_[index] : v1::ActuatorHello();
  }
  v1::ActuatorHeartbeat Heartbeat() {
    MutexLock lock(&mu_);
    return heartbeat_;
  }
  int port() const { return server_->port(); }

  // Under the lock: only in conditions given to Until.
  std::vector<v1::ActuatorHello> hellos_;
  std::vector<v1::Receipt> receipts_;
  v1::ActuatorHeartbeat heartbeat_;
  int overtook_ = 0;  // receipts that came before the heartbeat with their level
  bool leases_ = true;
  uint32_t heartbeat_ms_ = 0;
  std::vector<uint64_t> sent_ms_;  // when each heartbeat was sent

 private:
  std::optional<v1::ActuatorReply> NextReply(grpc::ServerContext* context) {
    MutexLock lock(&mu_);
    while (replies_.empty() && !closing_ && ended_ != context && !context->IsCancelled()) {
      changed_.WaitFor(lock, absl::Milliseconds(100));
    }
    if (replies_.empty()) return std::nullopt;
    v1::ActuatorReply reply = std::move(replies_.front());
    replies_.pop_front();
    return reply;
  }
  v1::ActuatorReply LeaseLocked() {
    v1::ActuatorReply reply;
    v1::Lease* lease = reply.mutable_lease();
    lease->mutable_heartbeat()->set_echo_boottime_ns(heartbeat_.heartbeat().clock().boottime_ns());
    lease->set_term(1);
    lease->set_ttl_ms(15'000);
    lease->set_heartbeat_ms(heartbeat_ms_);
    lease->set_evidence_complete(true);
    return reply;
  }

  Mutex mu_;
  CondVar changed_;
  std::deque<v1::ActuatorReply> replies_;
  bool closing_ = false;
  grpc::ServerContext* ended_ = nullptr;
  std::unique_ptr<rpc::RpcServer> server_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_LINK_FAKE_SERVER_H_
