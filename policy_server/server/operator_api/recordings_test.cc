// What was saved with an alert, on its way to an operator.
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/policy/recording/rips_writer.h"
#include "policy_server/server/flight/flight_files.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;

const std::string kAlert(32, 'a');

class AlertRecordingTest : public ::testing::Test {
 protected:
  void SetUp() override {
    char name[] = "/tmp/rips_recordings.XXXXXX";
    root_ = mkdtemp(name);
    files_ = *flight::FlightFiles::Open({.directory = root_ + "/r", .free_bytes_min = 0});
    server_credentials_ = *rpc::Credentials::Load(pki_.Server());
    operator_credentials_ = *rpc::Credentials::Load(pki_.Operator());
    Serve(files_.get());
  }
  ~AlertRecordingTest() override {
    server_.reset();
    service_.reset();
    std::filesystem::remove_all(root_);
  }
  void Serve(const flight::FlightFiles* files) {
    server_.reset();
    service_ = std::make_unique<OperatorService>(
        &pipeline_, &store_, &hub_,
        OperatorService::Access{.watch = &watch_, .quota = nullptr, .recordings = files});
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = server_credentials_->ForServer()},
        {service_.get()});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
    stub_ = rips::v1::OperatorService::NewStub(
        rpc::MakeChannel(server_->address(), operator_credentials_->ForClient()));
  }
  void Save(int events, size_t payload_bytes) {
    const recording::RecordedOrigin origin{
        .robot = "r1", .level = "ALERT", .alerts = {{.id = kAlert}}};
    std::string bytes = *recording::EncodeStart(origin);
    for (int i = 0; i < events; ++i) {
      bytes += *recording::EncodeFrame(
          {.time_unix_ns = i,
           .what = recording::RecordedMessage{.topic = "/t",
                                              .payload = std::string(payload_bytes, 'x'),
                                              .size_bytes = static_cast<uint32_t>(payload_bytes)}});
    }
    ASSERT_THAT(files_->Save(origin, bytes), IsOk());
  }
  // Reads to the end; what came.
  grpc::Status Fetch(const std::string& id, std::string* bytes = nullptr) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    rips::v1::GetAlertRecordingRequest request;
    request.set_alert_id(id);
    const auto reader = stub_->GetAlertRecording(&context, request);
    rips::v1::FilePiece piece;
    std::string all;
    while (reader->Read(&piece)) all += piece.data();
    const grpc::Status end = reader->Finish();
    EXPECT_TRUE(!end.ok() || all.size() == piece.file_bytes());
    if (bytes != nullptr) *bytes = std::move(all);
    return end;
  }
  std::string OnDisk() const {
    std::ifstream file(*files_->Find(kAlert), std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }

  rpc::TestPki pki_;
  std::string root_;
  RealClock clock_;
  store::FakeStore store_;
  StatusBroadcaster hub_{&store_, nullptr};
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&clock_};
  std::shared_ptr<const rpc::Credentials> server_credentials_;
  std::shared_ptr<const rpc::Credentials> operator_credentials_;
  std::unique_ptr<flight::FlightFiles> files_;
  std::unique_ptr<OperatorService> service_;
  std::unique_ptr<rpc::RpcServer> server_;
  std::unique_ptr<rips::v1::OperatorService::Stub> stub_;
};

// More than a stream may have waiting, so that it must be sent bit by bit; one event of it is larger
// than a message may be.
TEST_F(AlertRecordingTest, ComesWholeHoweverLongItIs) {
  Save(3, 5'000'000);
  std::string bytes;
  const grpc::Status end = Fetch("aaaaaa", &bytes);
  EXPECT_TRUE(end.ok()) << end.error_message();
  EXPECT_GT(bytes.size(), 15'000'000u);
  EXPECT_EQ(bytes, OnDisk());
  EXPECT_TRUE(Fetch(kAlert, &bytes).ok()) << "again";
}

TEST_F(AlertRecordingTest, WhatIsNotThereOrIsNoIdIsRefused) {
  Save(0, 0);
  EXPECT_TRUE(Fetch("aaaaaa").ok());
  EXPECT_EQ(Fetch("bbbbbb").error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(Fetch("aaaaa").error_code(), grpc::StatusCode::INVALID_ARGUMENT) << "too few";
  EXPECT_EQ(Fetch("../../etc/passwd").error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(Fetch("").error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  const std::string path = *files_->Find(kAlert);
  std::filesystem::remove(path);
  std::filesystem::create_symlink("/etc/passwd", path);
  EXPECT_EQ(Fetch(kAlert).error_code(), grpc::StatusCode::NOT_FOUND) << "no link is followed";
  std::filesystem::remove(path);
  EXPECT_EQ(Fetch(kAlert).error_code(), grpc::StatusCode::NOT_FOUND);
  Serve(nullptr);
  EXPECT_THAT(Fetch("aaaaaa").error_message(), HasSubstr("keeps no recordings"));
}

}  // namespace
}  // namespace rips::operator_api
