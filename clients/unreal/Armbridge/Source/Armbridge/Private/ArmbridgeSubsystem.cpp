#include "ArmbridgeSubsystem.h"

#include "ArmbridgeConnection.h"

bool UArmbridgeSubsystem::StopAll()
{
	bool bStopped = false;
	for (const TPair<FString, TSharedPtr<FArmbridgeConnection>>& Each : Connections)
	{
		bStopped |= Each.Value->Send(Armbridge::FArm::Stop());
	}
	return bStopped;
}

TSharedRef<FArmbridgeConnection> UArmbridgeSubsystem::Connect(const FString& Url, const FString& Token)
{
	TSharedPtr<FArmbridgeConnection>& Connection = Connections.FindOrAdd(Url);
	if (!Connection.IsValid())
	{
		Connection = MakeShared<FArmbridgeConnection>(Url, Token);
		Connection->Open();
	}
	return Connection.ToSharedRef();
}

void UArmbridgeSubsystem::Deinitialize()
{
	Connections.Empty();
	Super::Deinitialize();
}
